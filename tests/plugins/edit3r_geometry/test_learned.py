"""Learned features through kornia, with random weights in files named and laid out as the published
ones are.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from edit3r_geometry import features
from edit3r_geometry.cameras import calibrated_images
from edit3r_geometry.features import (
    FeatureSettings,
    FoundFeatures,
    find_features,
    with_learned,
)
from edit3r_geometry.keypoints import Keypoints
from edit3r_geometry.learned import LearnedFeatures
from edit3r_geometry.matchers import ClassicalMatcher, _Registered

from edit3r.contract.errors import InputError, MatchingError, MissingDependencyError


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """The folder that holds `aliked-lightglue/`, with its two files."""
    from kornia.feature import ALIKED, LightGlue

    torch.manual_seed(0)
    root = tmp_path_factory.mktemp("weights")
    folder = root / "aliked-lightglue"
    folder.mkdir()
    detector = ALIKED("aliked-n16")
    torch.save(detector.state_dict(), folder / "aliked-n16.pth")
    state = LightGlue(None, input_dim=128).state_dict()
    state.pop("confidence_thresholds", None)
    for layer in range(9):
        for kind in ("self", "cross"):
            old, new = f"transformers.{layer}.{kind}_attn.", f"{kind}_attn.{layer}."
            state = {name.replace(old, new): value for name, value in state.items()}
    torch.save(state, folder / "aliked_lightglue.pth")
    return root


@pytest.fixture(autouse=True)
def offline(monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("something was to be downloaded")

    monkeypatch.setattr("torch.hub.download_url_to_file", refuse)
    monkeypatch.setattr("kornia.feature.lightglue.load_state_dict_from_url", refuse)
    monkeypatch.setattr("kornia.feature.aliked.aliked.load_state_dict_from_url", refuse)


def settings(**chosen):
    few = {"keypoints": 300, "detection_size": 128, "learned_keypoints": 128}
    return FeatureSettings(**few, **chosen)


@pytest.mark.slow
def test_learned_matches_come_after_those_of_sift_whatever_the_number_of_threads(
    pair, weights, monkeypatch
):
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(weights))
    images = calibrated_images(pair.views, 0)
    before, answers = torch.get_num_threads(), []
    for threads in (1, 3):
        torch.set_num_threads(threads)
        answers.append(find_features(images, settings(matches="learned")))
        assert torch.get_num_threads() == threads
    torch.set_num_threads(before)
    found, again = answers
    alone = find_features(images, settings(matches="sift"))
    count = len(alone.indices[0, 1])
    assert (found.indices[0, 1][:count] == alone.indices[0, 1]).all()
    assert found.sift == tuple(map(len, alone.keypoints))
    assert len(found.keypoints[0]) > len(alone.keypoints[0])
    assert (found.learned(0, 1) == (np.arange(len(found.indices[0, 1])) >= count)).all()
    for one, other in zip(found.keypoints, again.keypoints):
        assert (one.points == other.points).all()
    assert (found.indices[0, 1] == again.indices[0, 1]).all()


@pytest.mark.slow
def test_learned_features_lie_inside_the_picture(pair, weights):
    image, _ = calibrated_images(pair.views, 0)
    networks = LearnedFeatures.load(weights / "aliked-lightglue", 64)
    points = networks.detect(image.pixels, 2 * max(image.size)).points
    assert 0 < len(points) <= 64
    assert (points > 0).all() and (points < np.array(image.size[::-1])).all()


@pytest.mark.slow
def test_features_beside_the_border_are_matched_too(weights):
    """The detector refines places by parts of a pixel, and LightGlue takes none outside."""
    networks = LearnedFeatures.load(weights / "aliked-lightglue", 64)
    points = np.array([[0.2, 0.1], [63.9, 47.9], [64.7, 48.6], [20.0, 30.0]])
    descriptors = np.random.default_rng(0).normal(size=(4, 128)).astype(np.float32)
    keypoints = Keypoints(points, descriptors)
    assert networks.match(keypoints, keypoints, ((48, 64), (48, 64))).shape[1] == 2


def test_without_the_weights_asking_for_them_names_the_command_and_auto_does_without(
    pair, tmp_path, monkeypatch
):
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    images = calibrated_images(pair.views, 0)
    command = "edit3r weights get aliked-lightglue"
    with pytest.raises(MissingDependencyError, match=command):
        find_features(images, settings(matches="learned"))
    assert not find_features(images, settings()).learned(0, 1).any()


@pytest.mark.slow
def test_auto_asks_the_networks_only_where_sift_finds_few(pair, weights, monkeypatch):
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(weights))
    images = calibrated_images(pair.views, 0)
    monkeypatch.setattr(features, "ENOUGH_MATCHES", 1)
    assert not find_features(images, settings()).sift
    monkeypatch.setattr(features, "ENOUGH_MATCHES", 10**6)
    assert find_features(images, settings()).sift
    monkeypatch.setattr(features, "MAX_LEARNED", 1)  # two photos are many then
    assert not find_features(images, settings()).sift
    assert find_features(images, settings(matches="learned")).sift


@pytest.mark.slow
def test_a_file_that_holds_something_else_is_said(weights, tmp_path):
    detector = (weights / "aliked-lightglue" / "aliked-n16.pth").read_bytes()
    (tmp_path / "aliked-n16.pth").write_bytes(detector)
    torch.save({"matcher.nothing": torch.zeros(1)}, tmp_path / "aliked_lightglue.pth")
    with pytest.raises(InputError, match="not the weights exp"):
        LearnedFeatures.load(tmp_path, 64)
    (tmp_path / "aliked-n16.pth").write_bytes(b"no weights")
    with pytest.raises(InputError, match=r"aliked-n16.pth: cannot be read as weights"):
        LearnedFeatures.load(tmp_path, 64)


def placed(features, lenses, registered=(True, True)):
    """What a matcher found: which photos it placed, and what lenses explain them alike."""
    registration = SimpleNamespace(registered=np.array(registered))
    return _Registered((), features, registration, None, lenses)


@pytest.mark.parametrize(
    "answer, taken",
    [
        (placed(None, None), True),
        (placed(None, None, (True, False)), False),
        (MatchingError("nothing agrees"), False),
    ],
    ids=["tells the lens", "loses a photo", "places nothing"],
)
def test_photos_whose_lens_sift_does_not_tell_are_matched_by_learned_features_too(
    pair, monkeypatch, answer, taken
):
    monkeypatch.setattr(features, "at_hand", lambda _: "weights")
    monkeypatch.setattr(
        features, "_with_learned", lambda found, *_: replace(found, helper="learned")
    )
    first = placed(None, (30.0, 70.0))
    monkeypatch.setattr(
        ClassicalMatcher,
        "_attempt",
        lambda self, views, images, found: answer if found.helper else first,
    )
    few = ClassicalMatcher.Settings(keypoints=300, detection_size=128)
    monkeypatch.setattr(features, "_loose_pairs", lambda found: [])
    found = ClassicalMatcher(few).register(pair.views, 0)
    assert (found is answer) == taken and (found is first) != taken


@pytest.mark.parametrize(
    "matches, wanted, helped",
    [(499, "auto", True), (500, "auto", False), (499, "sift", False)],
)
def test_pairs_with_many_matches_and_those_for_sift_alone_are_not_helped(
    monkeypatch, matches, wanted, helped
):
    monkeypatch.setattr(features, "at_hand", lambda _: "weights")
    monkeypatch.setattr(features, "_with_learned", lambda *_: "helped")
    found = FoundFeatures((), {(0, 1): np.zeros((matches, 2), int)})
    answer = with_learned(found, [], settings(matches=wanted))
    assert answer == "helped" if helped else answer is found
