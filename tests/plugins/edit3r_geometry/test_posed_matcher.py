"""Depth from known poses."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from edit3r_geometry import matchers

import edit3r
from edit3r.contract.errors import MatchingError
from edit3r.contract.interfaces import Matcher
from edit3r_testing import Contract, MatcherContract, claims, contract_for
from edit3r_testing.scenes import photograph


class Elsewhere(Matcher):
    def match(self, views):
        return "asked"


@pytest.fixture(scope="module")
def matcher():
    less = {"planes": 48, "detection_size": 256}
    return edit3r.build("matcher", "posed", {"matcher": Elsewhere()}, **less)


@pytest.fixture(scope="module")
def large():
    truth = photograph(2, (96, 128))
    return truth, replace(truth.views, c2w=truth.cameras.c2w)


def test_depth_is_measured_in_the_unit_of_the_known_poses(matcher, large):
    truth, views = large
    found = matcher.match(views)
    sure = found.confidence > 0.5
    error = ((found.depths - truth.depths) / truth.depths).abs()[sure]
    assert torch.equal(found.c2w, truth.cameras.c2w) and found.registered.all()
    assert sure.float().mean() > 0.5 and error.median() < 0.02


def test_views_without_poses_go_to_the_other_matcher(matcher, large):
    assert matcher.match(large[0].views) == "asked"


def test_poses_that_do_not_belong_to_the_photos_are_refused(matcher, large):
    _, views = large
    away = views.c2w.clone()
    # turned about the optical axis
    away[0, 1, :3, :3] = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    with pytest.raises(MatchingError, match="known poses"):
        matcher.match(replace(views, c2w=away))


def test_depth_is_measured_on_the_corrected_photos(matcher, large, monkeypatch):
    _, views = large
    darker, seen = replace(views, images=0.8 * views.images), []
    measure = matchers.measure_depths
    spy = lambda images, *rest: seen.append(images) or measure(images, *rest)  # noqa: E731
    monkeypatch.setattr(matchers, "measure_depths", spy)
    matcher.match_corrected(darker, views)
    (images,) = seen
    for image, corrected in zip(images, matchers.calibrated_images(views, 0)):
        assert np.array_equal(image.pixels, corrected.pixels)


class PosedContract(MatcherContract):
    """Its photos come with their poses."""

    component = "posed"

    def scene(self, *args, **given):
        scene = super().scene(*args, **given)
        return replace(scene, views=replace(scene.views, c2w=scene.cameras.c2w))


@pytest.mark.slow
@pytest.mark.parametrize(
    "claim", sorted({*claims(MatcherContract)} - {*claims(Contract)})
)
@pytest.mark.parametrize(
    "contract", [PosedContract, contract_for("matcher", "auto")], ids=["posed", "auto"]
)
def test_contract(contract, claim):
    getattr(contract(), claim)()
