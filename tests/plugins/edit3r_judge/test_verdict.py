"""The verdict follows the renderings of the input views, names the worst photo, and hides none that
was left out.
"""

from dataclasses import replace

import pytest
import torch
from edit3r_judge.blame import Doubt
from edit3r_judge.signals import fitted_limits
from edit3r_judge.verdict import judge
from torch.nn.functional import interpolate

from edit3r.contract.interfaces import HalfWay, SceneToJudge
from edit3r.contract.types import Rendering, Views
from edit3r_testing import gaussian_cloud
from edit3r_testing.scenes import cameras_around

EDITED = Views(
    torch.full((1, 3, 3, 8, 8), 0.5), torch.eye(3).expand(1, 3, 3, 3), ("a", "b", "c")
)


def rendered(*psnr: float) -> Rendering:
    """Renderings that differ from EDITED by exactly so much [dB]."""
    off = torch.tensor([10 ** (-value / 20) for value in psnr])
    images = 0.5 + off[None, :, None, None, None].expand(1, len(psnr), 3, 8, 8)
    alphas = torch.full((1, len(psnr), 1, 8, 8), 0.75)
    return Rendering(images, alphas, alphas)


def scene(edited, first, placed=(True,) * 3, final=None, measured=None, **others):
    """A scene that no refiner touched, where `final` is not given."""
    final = final or first
    cameras = cameras_around(edited.count)
    drawn = (edited, cameras, gaussian_cloud(1), first, final)
    return SceneToJudge(edited, placed, None, *drawn, measured, **others)


def shown(edited, rendering, placed=(True,) * 3, guessed=None):
    """The verdict on it, of which so much is guessed half-way."""
    guessed = None if guessed is None else torch.tensor([guessed])
    return judge(scene(edited, rendering, tuple(placed)), guessed)


def test_the_figures_are_those_of_the_renderings():
    three = rendered(30.0, 20.0, 10.0)
    measured, guessed = torch.tensor([[[0.9, 0.5, 1.0]], [[0.1, 0.1, 0.3]]])
    verdict = judge(scene(EDITED, three, measured=measured), guessed)
    assert verdict.input_psnr == pytest.approx((30, 20, 10), abs=1e-3)
    assert verdict.coverage == pytest.approx((0.75,) * 3)
    assert verdict.filled == pytest.approx((0.1, 0.5, 0.0))
    assert verdict.guessed_between == pytest.approx((0.1, 0.1, 0.3))


def test_a_scene_that_does_not_show_its_worst_photo_failed():
    worst = fitted_limits("scene")["agreement"]
    enough = shown(EDITED, rendered(45.0, 45.0, worst + 0.1))
    too_low = shown(EDITED, rendered(45.0, 45.0, worst - 0.1))
    assert (enough.label, too_low.label) == ("good", "failed")


def test_what_is_bad_is_said_with_the_photo_and_the_way_out():
    verdict = shown(EDITED, rendered(30.0, 10.0, 30.0))
    assert verdict.label == "failed"
    assert "b hardly at all; leave b out, or" in verdict.reason


def test_where_the_photos_are_not_to_blame_the_advice_is_about_what_is():
    doubt = Doubt("look at the edits", "editor")
    for psnr, label in ((40.0, "fair"), (11.5, "failed")):
        rendering = rendered(psnr, psnr, psnr)
        verdict = judge(scene(EDITED, rendering), doubt=doubt)
        assert verdict.label == label
        assert verdict.reason.endswith("; look at the edits.")
        assert verdict.part == "editor"
        assert "add photos" not in verdict.reason
    fits = scene(EDITED, rendered(40.0, 40.0, 40.0))
    good = judge(fits, doubt=Doubt("moved back", "editor", "good"))
    assert good.label == "good" and good.part is None and "moved" not in good.reason


@pytest.mark.parametrize(
    ("psnr", "seen"),
    [
        ((31, 31, 31), "as they are"),
        ((31, 23, 19), "softer"),
        ((19, 19, 19), "only roughly"),
    ],
)
def test_how_sharp_photos_are_on_the_whole_is_said_in_words(psnr, seen):
    reason = shown(EDITED, rendered(*psnr)).reason
    assert f"shows its photos {seen}" in reason and "dB" not in reason


def test_a_photo_that_was_left_out_has_no_figures_and_the_run_is_not_good():
    placed = (True, False, True)
    verdict = shown(EDITED.select([0, 2]), rendered(40.0, 41.0), placed)
    assert verdict.label == "fair" and verdict.placed == placed
    assert "1 of 3 photos could not be placed" in verdict.reason
    assert verdict.input_psnr[1] is verdict.filled[1] is None
    assert verdict.input_psnr[2] == pytest.approx(41, abs=1e-3)


def test_a_run_without_most_of_its_photos_failed():
    verdict = shown(EDITED.select([0]), rendered(40.0), [True] + 3 * [False])
    assert verdict.label == "failed"
    assert "3 of 4 photos could not be placed" in verdict.reason
    half = shown(EDITED.select([0, 1]), rendered(40.0, 40.0), [True, False] * 2)
    assert half.label == "fair"


@pytest.mark.parametrize(
    ("over", "beyond", "label"),
    [("good", -0.01, "good"), ("good", 0.01, "fair"), ("fair", 0.01, "poor")],
)
def test_one_view_between_that_is_guessed_counts_and_its_photo_is_named(
    over, beyond, label
):
    most = fitted_limits("scene")[over]["half_way"] + beyond
    verdict = shown(EDITED, rendered(40.0, 41.0, 42.0), [True] * 3, [0.0, 0.0, most])
    assert verdict.label == label
    assert (label == "good") != ("add photos between it" in verdict.reason)
    if label != "good":
        between = f"between c and the photo nearest to it, {most:.0%} of the picture is guessed"
        assert between in verdict.reason
        assert "leave c out" in verdict.reason


PATTERN = torch.rand(3, 1, 12, 12, generator=torch.Generator().manual_seed(0))
PICTURES = Views(
    interpolate(PATTERN, (96, 96)).expand(3, 3, 96, 96)[None],
    torch.eye(3).expand(1, 3, 3, 3),
    ("a", "b", "c"),
)


def test_a_view_half_way_that_looks_like_neither_photo_counts_and_its_photos_are_named():
    """Half-way between a and b stands a; half-way between b and c half of the picture is grey."""
    alphas = torch.ones(1, 3, 1, 96, 96)
    images = PICTURES.images[:, :2].clone()
    images[0, 1, :, 48:] = 0.5
    seen = Rendering(images, alphas[:, :2], alphas[:, :2])
    half_way = HalfWay(seen, cameras_around(2), ((0, 1), (1, 2)))
    shown = Rendering(PICTURES.images, alphas, alphas)
    given = scene(PICTURES, shown)
    assert judge(given).label == "good" and judge(given).unlike_between == (None,) * 3
    verdict = judge(replace(given, half_way=half_way))
    one, two, three = verdict.unlike_between
    assert one == pytest.approx(0, abs=0.01) and two == three > 0.3
    assert verdict.label == "fair" and "half-way between b" in verdict.reason
    assert f"{two:.0%} looks like no photo" in verdict.reason
    # what is guessed there and what looks like no photo count together
    guessed = torch.tensor([[0.0, 0.6, 0.0]])
    assert judge(replace(given, half_way=half_way), guessed).label == "poor"


def test_a_rendering_equal_to_the_photo_has_a_finite_figure():
    alphas = EDITED.images[:, :, :1]
    verdict = shown(EDITED, Rendering(EDITED.images, alphas, alphas))
    assert verdict.input_psnr[0] == 100


def test_steps_towards_the_photos_make_no_bad_scene_good():
    first, final = rendered(30.0, 10.0, 30.0), rendered(30.0, 30.0, 30.0)
    verdict = judge(scene(EDITED, first, final=final))
    assert verdict.label == "failed" and "and b hardly at all" in verdict.reason
    assert verdict.input_psnr[1] == pytest.approx(30, abs=1e-3)
    assert verdict.agreement[1] == pytest.approx(10, abs=1e-3)


def test_a_scene_that_refiners_made_worse_is_judged_by_what_is_left():
    first, final = rendered(40.0, 40.0, 40.0), rendered(*[10.0] * 3)
    assert judge(scene(EDITED, first, final=final)).label == "failed"


def test_where_most_photos_do_not_find_to_the_first_it_is_to_blame():
    placed = [True, True, False, False, False]
    verdict = shown(EDITED.select([0, 1]), rendered(15.0, 15.0), placed)
    assert "share with a: begin with another photo" in verdict.reason


def test_of_several_scenes_the_worst_counts():
    one, other = rendered(40.0, 10.0, 40.0), rendered(40.0, 40.0, 12.0)
    images, alphas = (
        torch.cat((getattr(one, name), getattr(other, name)))
        for name in ("images", "alphas")
    )
    twice = Views(
        EDITED.images.expand(2, -1, -1, -1, -1), EDITED.intrinsics.expand(2, -1, -1, -1)
    )
    verdict = shown(twice, Rendering(images, alphas, None))
    assert verdict.input_psnr == pytest.approx((40, 10, 12), abs=1e-3)
