"""What leaves the scene, and where it may change."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from edit3r.contract.errors import MatchingError
from edit3r.contract.interfaces import Geometry, Matcher
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import Cameras, Gaussians, Reconstruction
from edit3r.loading.registry import build
from edit3r.running.steps.reconstruct import (
    _after_edit,
    _masks_of_change,
    _only_placed,
)
from edit3r_testing import photograph


def test_gaussians_of_no_photo_stay_where_a_photo_has_no_place():
    count = 4
    gaussians = Gaussians(
        torch.arange(3.0 * count).view(1, count, 3),
        torch.ones(1, count, 3),
        torch.tensor([1.0, 0, 0, 0]).expand(1, count, 4),
        torch.ones(1, count),
        torch.zeros(1, count, 1, 3),
        torch.tensor([0, 1, 2, -1]),
    )
    lens = torch.tensor([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]]).expand(1, 3, 3, 3)
    cameras = Cameras(torch.eye(4).expand(1, 3, 4, 4), lens, (8, 8))
    placed = torch.tensor([[True, False, True]])
    left = _only_placed(Reconstruction(gaussians, cameras, placed=placed))
    assert left.gaussians.view_index.tolist() == [0, 1, -1]
    assert torch.equal(left.gaussians.means, gaussians.means[:, [0, 2, 3]])


def test_photos_that_are_not_edited_hold_nothing_back():
    start = SimpleNamespace(images=torch.zeros(1, 3, 3, 4, 6))
    edited = start.images.clone()
    edited[:, 0, 1, 2, 3] = 1
    changed = _masks_of_change(
        SimpleNamespace(start=start, before=object()),
        SimpleNamespace(masks=None),
        SimpleNamespace(views=SimpleNamespace(images=edited)),
        SimpleNamespace(edited_count=lambda views: 1),
    )
    assert changed[0, 0].nonzero().tolist() == [[2, 3]] and changed[0, 1:].all()


class PlacesNothing(Matcher):
    def match(self, views):
        raise MatchingError("they share too little")


def test_edited_photos_that_cannot_be_placed_stand_where_the_photos_do():
    """A large thing is removed, and what is left has too little to be matched by."""
    scene = photograph(2, (96, 128))
    depths, sure = scene.depths, torch.ones_like(scene.depths)
    placed = torch.ones(1, 2, dtype=torch.bool)
    lens = scene.views.intrinsics
    of_photos = Geometry(scene.cameras.c2w, depths, sure, placed, lens)
    components = SimpleNamespace(
        geometry_source=PlacesNothing(),
        matcher_of_known_poses=build("matcher", "posed"),
    )
    edited = replace(scene.views, c2w=None, intrinsics=lens * 1.5)  # nobody knows it
    report = Report()
    with collecting(report):
        found = _after_edit(edited, of_photos, components)
    assert "keep the cameras of the photos" in report.warnings[0]
    assert torch.allclose(found.c2w, of_photos.c2w, atol=1e-6)
    assert torch.equal(found.intrinsics, lens)
    errors = (found.depths / depths - 1).abs()[found.confidence >= 0.5]
    assert len(errors) > 0.3 * depths.numel() and errors.median() < 0.02
    with pytest.raises(MatchingError, match="share too little"):
        _after_edit(edited, None, components)
