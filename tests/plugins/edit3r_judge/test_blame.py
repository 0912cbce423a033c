"""A part that is broken makes the scene poor and is named; sound ones are not blamed."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from edit3r_judge import blame
from edit3r_judge.skill import Skill

import edit3r
from edit3r.contract.interfaces import Matcher, Rasterizer, Refiner
from edit3r.contract.reporting import Report
from edit3r_testing import photograph
from edit3r_testing.broken import KINDS, BrokenReconstructor, without_views
from edit3r_testing.scenes import true_geometry

pytestmark = pytest.mark.slow
SCENE = photograph(2, (192, 256))
PLAIN = {"gaussians": "all", "refine": 0, "refiners": (), "outputs": []}


class Knows(Matcher):
    """What a matcher without errors reads, spoilt."""

    def __init__(self, spoil=lambda geometry: geometry):
        super().__init__(None)
        self.spoil = spoil

    def match(self, views):
        return self.spoil(true_geometry(views))


def verdict_of(recon=None, *, views=SCENE.views, matcher=None, **settings):
    """The verdict on the tiny scene, made of what is given."""
    return edit3r.run(
        views,
        editor="none",
        recon=recon or BrokenReconstructor(),
        matcher=matcher or Knows(),
        report=Report(),
        **PLAIN | settings,
    ).verdict


def test_what_is_sound_is_good_and_nobody_is_to_blame():
    verdict = verdict_of()
    assert (verdict.label, verdict.part) == ("good", None), verdict.reason
    assert max(verdict.beside_geometry) == pytest.approx(1, abs=0.05)
    assert max(map(abs, verdict.beside_reference)) < 0.03
    assert max(verdict.beside_flat) < 0.6


@pytest.mark.parametrize("kind", KINDS)
def test_a_broken_reconstructor_is_poor_and_named(kind):
    verdict = verdict_of(BrokenReconstructor(kind, KINDS[kind][-1]))
    assert verdict.label in ("poor", "failed"), verdict
    assert verdict.part == "reconstructor"
    assert "the reconstructor BrokenReconstructor" in verdict.reason
    assert "photos nearer" not in verdict.reason


class OfNobody(BrokenReconstructor):
    """Nobody knows whose its Gaussians are."""

    def __call__(self, *given):
        made = super().__call__(*given)
        return replace(made, gaussians=without_views(made.gaussians))


@pytest.mark.parametrize("kind", ["plane", "noise", "turned", "exchanged"])
def test_a_scene_whose_gaussians_come_from_no_view_is_told_by_what_it_shows(kind):
    assert verdict_of(OfNobody()).label == "good"
    verdict = verdict_of(OfNobody(kind, KINDS[kind][-1]))
    assert (verdict.label, verdict.part) == ("poor", "reconstructor")


def test_of_two_neighbours_of_a_photo_the_worse_counts(monkeypatch):
    seen = [Skill(0, 6.0, 3.0, 8.0), Skill(0, 9.0, 9.0, None), Skill(1, 4.0, 4.0, 8.0)]
    monkeypatch.setattr(blame, "skills", lambda scene: seen)
    scene = SimpleNamespace(edited=SCENE.views, reference=None)
    found = blame.beside(scene)
    assert (found.geometry, found.flat) == ([2.0, 1.0], [3 / 8, 0.5])


class Alone(BrokenReconstructor):
    """Uses no geometry of the run, as a network in a single pass."""

    uses_geometry = False

    def __call__(self, views, source=None, geometry=None, grid=None):
        return super().__call__(views, source, true_geometry(views), grid)


def test_a_single_pass_without_depth_is_no_better_than_one_flat_picture():
    assert verdict_of(Alone()).label == "good"
    verdict = verdict_of(Alone("plane", 1.0))
    assert (verdict.label, verdict.part) == ("poor", "reconstructor")
    assert "no better than one flat picture" in verdict.reason


def mirrored(geometry):
    """Poses on the wrong side of the first camera."""
    c2w = geometry.c2w.clone()
    c2w[:, 1:, :3, 3] *= -1
    return replace(geometry, c2w=c2w)


def test_a_matcher_with_mirrored_poses_is_named_and_not_who_believed_it():
    verdict = verdict_of(matcher=Knows(mirrored))
    assert (verdict.label, verdict.part) == ("poor", "geometry")
    assert "Knows" in verdict.reason


class Deep(Rasterizer):
    """Draws right pictures, and depths that are too large."""

    def __init__(self):
        super().__init__(None)
        self.inner = edit3r.build("rasterizer", "auto")
        self.gives = self.inner.gives

    def render(self, gaussians, cameras):
        shown = self.inner.render(gaussians, cameras)
        return replace(shown, depths=1.4 * shown.depths)


def test_a_rasterizer_with_wrong_depths_is_named():
    verdict = verdict_of(rasterizer=Deep())
    assert (verdict.label, verdict.part) == ("poor", "rasterizer")
    assert "rasterizer Deep draws depths that are off by 40%" in verdict.reason


class Blurs(Refiner):
    """Makes every Gaussian eight times as wide."""

    def __init__(self):
        super().__init__(None)

    def __call__(self, gaussians, inputs):
        return replace(gaussians, scales=8 * gaussians.scales)


def test_refiners_that_make_it_worse_are_named(monkeypatch):
    from edit3r.running.components import Components

    monkeypatch.setattr(Components, "refiners", (Blurs(),))
    verdict = verdict_of()
    assert (verdict.label, verdict.part) == ("poor", "refiner")
    assert "the refiners Blurs made it worse" in verdict.reason


def test_what_refiners_do_to_the_view_half_way_is_no_fault_of_the_reconstructor(
    monkeypatch,
):
    from edit3r.running.components import Components

    sharp = verdict_of()
    monkeypatch.setattr(Components, "refiners", (Blurs(),))
    blurred = verdict_of()
    assert max(blurred.unlike_between) > 0.05 + max(sharp.unlike_between)
    assert blurred.beside_reference == pytest.approx(sharp.beside_reference)


def test_of_many_photos_scene_and_reference_are_looked_at_from_the_same_eight_places():
    verdict = verdict_of(views=photograph(14, (48, 64)).views)
    told = [one for one in verdict.beside_reference if one is not None]
    assert len(told) < 14 and None not in verdict.unlike_between
    assert told == pytest.approx([0] * len(told), abs=1e-6)


def test_a_thing_that_is_flat_is_not_taken_for_a_scene_without_depth():
    """All on one plane: a homography is right there, and says nothing."""
    images = SCENE.views.images[:, :1].expand(-1, 2, -1, -1, -1).clone()
    images[:, 1] = images[:, 1].roll(6, -1)
    views = replace(SCENE.views, images=images)
    geometry = true_geometry(SCENE.views)
    depths = torch.full_like(geometry.depths, 3.0)
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    focal = float(SCENE.views.intrinsics[0, 0, 0, 0]) * 256
    c2w[0, 1, 0, 3] = -6 / focal * 3
    flat = replace(geometry, depths=depths, c2w=c2w)
    made = verdict_of(views=views, matcher=Knows(lambda _: flat))
    assert made.label in ("good", "fair") and set(made.beside_flat) == {None}
