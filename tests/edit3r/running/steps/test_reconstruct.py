"""What leaves the scene, and where it may change."""

from types import SimpleNamespace

import pytest
import torch

from edit3r.contract.errors import MatchingError
from edit3r.contract.interfaces import Geometry, Matcher
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import Cameras, Reconstruction
from edit3r.running.steps.reconstruct import (
    _after_edit,
    _masks_of_change,
    _only_placed,
)
from edit3r_testing import photograph
from edit3r_testing.scenes import balls


def test_gaussians_of_no_photo_stay_where_a_photo_has_no_place():
    places = torch.arange(12.0).view(1, 4, 3)
    gaussians = balls(places, view_index=torch.tensor([0, 1, 2, -1]))
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
    """A ball is removed: depth goes on from the wall around it, and is no measured one."""
    scene = photograph(2, (48, 64))
    inverse = torch.full_like(scene.depths, 0.25)
    changed = torch.zeros_like(inverse, dtype=torch.bool)
    changed[..., 10:30, 20:40] = True
    placed = torch.ones(1, 2, dtype=torch.bool)
    ball = torch.where(changed, 1.0, inverse)
    sure = torch.ones_like(ball)
    of_photos = Geometry(scene.cameras.c2w, 1 / ball, sure, placed)
    components = SimpleNamespace(geometry_source=PlacesNothing())
    report = Report()
    with collecting(report):
        found = _after_edit(scene.views, changed, of_photos, components)
    assert "keep the photos' cameras" in report.warnings[0]
    assert torch.equal(found.c2w, of_photos.c2w)
    assert torch.allclose(1 / found.depths, inverse, atol=1e-4)
    assert (found.confidence[changed] == 0).all() and found.confidence[..., 0].all()
    for nowhere in ((changed, None), (torch.ones_like(changed), of_photos)):
        with pytest.raises(MatchingError, match="share too little"):
            _after_edit(scene.views, *nowhere, components)
