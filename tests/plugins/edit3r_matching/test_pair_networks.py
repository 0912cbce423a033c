"""EfficientLoFTR and SuperPoint + LightGlue of transformers, from tiny random folders of
`save_pretrained`.
"""

import json

import numpy as np
import pytest
import torch
from edit3r_matching.cameras import calibrated_images
from edit3r_matching.features import FeatureSettings, find_features
from edit3r_matching.learned import PairNetwork, load

import edit3r
from edit3r.contract.errors import InputError, MissingDependencyError
from edit3r.loading.weights import named

WEIGHTS = {"efficientloftr": "efficientloftr", "superpoint": "superpoint-lightglue"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder of weights with both tiny networks."""
    from transformers import (
        EfficientLoFTRConfig,
        EfficientLoFTRForKeypointMatching,
        LightGlueConfig,
        LightGlueForKeypointMatching,
        SuperPointConfig,
    )

    torch.manual_seed(0)
    root = tmp_path_factory.mktemp("weights")
    semi_dense = EfficientLoFTRConfig(
        stage_num_blocks=[1, 1, 1, 1],
        out_features=[16, 16, 16, 32],
        hidden_size=32,
        num_attention_layers=1,
        num_attention_heads=8,
        coarse_matching_threshold=0.0,
    )
    network = EfficientLoFTRForKeypointMatching(semi_dense)
    for (
        weight
    ) in network.parameters():  # its own beginning gives features that are all the same
        torch.nn.init.normal_(weight, std=0.3)
    network.save_pretrained(root / "efficientloftr")
    points = SuperPointConfig(
        encoder_hidden_sizes=[8, 8, 16, 16],
        decoder_hidden_size=16,
        descriptor_decoder_dim=32,
        keypoint_threshold=0.0,
    )
    sparse = LightGlueConfig(
        keypoint_detector_config=points.to_dict(),
        descriptor_dim=32,
        num_hidden_layers=2,
        num_attention_heads=2,
        filter_threshold=0.0,
    )
    LightGlueForKeypointMatching(sparse).save_pretrained(root / "superpoint-lightglue")
    return root


@pytest.fixture
def at_hand(folder, monkeypatch):
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(folder))


def settings(**chosen):
    return FeatureSettings(
        keypoints=300, detection_size=128, learned_keypoints=128, **chosen
    )


@pytest.mark.parametrize("source", WEIGHTS)
def test_matches_of_both_come_after_those_of_sift_and_are_the_same_with_any_number_of_threads(
    source, make_room, at_hand
):
    images = calibrated_images(make_room([(0,), (0.3, 0.05, -5), (0.5,)]).views, 0)
    before, answers = torch.get_num_threads(), []
    for threads in (1, 3):
        torch.set_num_threads(threads)
        answers.append(find_features(images, settings(matches=source)))
    torch.set_num_threads(before)
    found, again = answers
    alone = find_features(images, settings(matches="sift"))
    assert sum(int(found.learned(a, b).sum()) for a, b in found.indices) > 0
    for pair, indices in alone.indices.items():
        assert (found.indices[pair][: len(indices)] == indices).all()
        assert (found.indices[pair] == again.indices[pair]).all()
        assert found.learned(*pair).sum() <= 128
    for image, keys in zip(images, found.keypoints):
        assert (keys.points > -4).all() and (
            keys.points < np.array(image.size[::-1]) + 4
        ).all()


def test_a_point_that_two_pairs_see_is_one_feature(make_room, folder):
    """So that tracks through three photos exist: SuperPoint finds the same points in a photo
    whatever its partner.
    """
    images = calibrated_images(make_room([(0,), (0.3,), (0.5,)]).views, 0)
    networks = load("superpoint-lightglue", folder / "superpoint-lightglue", 64)
    found, indices = networks.between(
        {i: one.pixels for i, one in enumerate(images)}, [(0, 1), (0, 2)], 128
    )
    assert set(indices[0, 1][:, 0]) & set(indices[0, 2][:, 0])
    assert len(np.unique(found[0].points, axis=0)) == len(found[0])


def test_points_lie_where_a_detector_of_the_same_library_sees_them(make_room, folder):
    from transformers import LightGlueForKeypointMatching

    (image, _) = calibrated_images(make_room([(0,), (0.3,)], size=(128, 160)).views, 0)
    networks = load("superpoint-lightglue", folder / "superpoint-lightglue", 64)
    found, _ = networks.between({0: image.pixels, 1: image.pixels}, [(0, 1)], 320)
    detector = LightGlueForKeypointMatching.from_pretrained(
        folder / "superpoint-lightglue"
    ).keypoint_detector.eval()
    from edit3r_matching.learned import _grey

    grey = torch.from_numpy(_grey(image.pixels, 320))  # twice the size
    with torch.inference_mode():
        seen = detector(grey.expand(1, 3, -1, -1)).keypoints[
            0
        ].double().numpy() * np.array([320, 256])
    expected = {tuple(point) for point in np.round((seen + 0.5) / 2, 3)}
    assert (
        len(found[0])
        and {tuple(point) for point in np.round(found[0].points, 3)} <= expected
    )


def test_efficientloftr_pairs_what_looks_alike_even_where_the_order_of_the_places_changes(
    folder,
):
    """The library's own lists run in different orders, which shows only where something moves past
    something else.
    """
    networks = load("efficientloftr", folder / "efficientloftr", 1000)
    assert isinstance(networks, PairNetwork)
    network = networks.network
    network.config.coarse_matching_threshold = 0.2
    generator = torch.Generator().manual_seed(0)
    features = torch.randn(1, 1, 32, 12, 12, generator=generator)
    features = 40 * features / features.norm(dim=2, keepdim=True)
    rows = torch.randperm(12, generator=generator)
    keypoints, scores, _ = network._coarse_matching(
        torch.cat([features, features[..., rows, :]], 1), 8.0
    )
    (a, b), sure = (keypoints[0] / 8).long(), scores[0, 0] > 0
    assert sure.sum() > 20 and (scores[0, 0] == scores[0, 1]).all()
    assert (rows[b[sure][:, 1]] == a[sure][:, 1]).all() and (
        a[sure][:, 0] == b[sure][:, 0]
    ).all()
    assert (
        (a[sure] >= 2) & (a[sure] < 10) & (b[sure] >= 2) & (b[sure] < 10)
    ).all()  # the border is left out


@pytest.mark.parametrize("source", WEIGHTS)
def test_without_the_weights_the_licence_and_the_command_are_named(
    source, pair, tmp_path, monkeypatch
):
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    with pytest.raises(
        MissingDependencyError,
        match=f"edit3r weights get {WEIGHTS[source]} .*commercial use",
    ):
        find_features(calibrated_images(pair.views, 0), settings(matches=source))


def test_superpoint_is_declared_as_not_for_commercial_use():
    superpoint = named("superpoint-lightglue")
    assert superpoint.commercial == "no" and "non-commercial" in superpoint.licence
    assert named("efficientloftr").commercial == "yes"


def test_files_that_lack_weights_are_refused(folder, tmp_path):
    from safetensors.torch import load_file, save_file

    state = load_file(folder / "efficientloftr" / "model.safetensors")
    save_file(
        dict(list(state.items())[1:]), tmp_path / "model.safetensors", {"format": "pt"}
    )
    (tmp_path / "config.json").write_text(
        json.dumps(json.loads((folder / "efficientloftr/config.json").read_text()))
    )
    with pytest.raises(
        InputError, match="lacks 1 weights of EfficientLoFTRForKeypointMatching"
    ):
        load("efficientloftr", tmp_path, 64)


@pytest.mark.parametrize("source", WEIGHTS)
def test_random_weights_do_not_move_what_sift_places(source, pair, at_hand):
    """Wrong matches of a network are held to the same gates as the other learned source's."""
    truth = pair.c2w[1][:3, :3]
    geometry = edit3r.build(
        "matcher", "classical", matches=source, detection_size=256
    ).match(pair.views)
    turned = np.trace(truth.T @ geometry.c2w[0, 1, :3, :3].double().numpy())
    assert np.degrees(np.arccos(min(1, (turned - 1) / 2))) < 0.5
