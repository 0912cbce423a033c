import kornia
import numpy as np
import pytest
import torch
from edit3r_recolor.recoloring import RecolorParameters
from edit3r_recolor.steps import (
    _lightness_curve,
    apply_change,
    paint,
    tint,
    weighted_median,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from edit3r.compute.colour import lab_to_rgb, rgb_to_lab
from edit3r.contract.wishes import Change
from edit3r.wishes.vocabulary import BASIC_COLOURS, read_colour

ONES = torch.ones(1, 16, 16)


def shaded(rgb=(0.5, 0.4, 0.3)) -> torch.Tensor:
    """A surface of one colour in light that falls off from left to right, 1 view of 16x16."""
    light = torch.linspace(1, 0.4, 16)[None, None, None, :].expand(1, 3, 16, 16)
    return torch.tensor(rgb)[None, :, None, None] * light


def lightness(images: torch.Tensor) -> torch.Tensor:
    return kornia.color.rgb_to_lab(images)[:, 0]


def hue(rgb: torch.Tensor) -> float:
    return float(kornia.color.rgb_to_hsv(rgb.reshape(1, 3, 1, 1))[0, 0, 0, 0]) / (
        2 * torch.pi
    )


def test_lab_is_that_of_kornia_and_back():
    images = torch.rand(2, 3, 32, 32, generator=torch.Generator().manual_seed(0))
    lab = rgb_to_lab(images)
    torch.testing.assert_close(lab, kornia.color.rgb_to_lab(images))
    torch.testing.assert_close(
        lab_to_rgb(1.2 * lab), kornia.color.lab_to_rgb(1.2 * lab)
    )
    torch.testing.assert_close(lab_to_rgb(lab), images, atol=2e-5, rtol=0)


@pytest.mark.parametrize(
    "start, goal", [(50.0, 40.0), (3.0, 90.0), (97.0, 12.0), (20.0, 60.0)]
)
def test_the_lightness_curve_is_the_monotone_cubic_through_three_points(start, goal):
    values = torch.linspace(-5, 105, 300)[None, None]
    ends = max(0.0, goal - 1.2 * start), min(100.0, goal + 1.2 * (100 - start))
    cubic = PchipInterpolator([0.0, start, 100.0], [ends[0], goal, ends[1]])
    expected = torch.from_numpy(cubic(np.clip(values.numpy(), 0, 100))).float()
    torch.testing.assert_close(_lightness_curve(values, start, goal), expected)


@pytest.mark.parametrize("colour", BASIC_COLOURS)
@pytest.mark.parametrize(
    "surface", [(0.5, 0.4, 0.3), (0.05, 0.05, 0.06), (0.95, 0.95, 0.9), (0.1, 0.2, 0.8)]
)
def test_paint_keeps_the_order_of_light_and_shade(colour, surface):
    before, after = (
        lightness(shaded(surface)),
        lightness(paint(shaded(surface), ONES, read_colour([colour])[0].rgb)),
    )
    steps = after[0, 0].diff()
    assert (before[0, 0].diff() < 0).all() and (steps < 0.05).all()
    assert after.max() - after.min() > 0.25 * min(
        20.0, float(before.max() - before.min())
    )


@pytest.mark.parametrize(
    "colour", ["red", "orange", "yellow", "green", "turquoise", "purple", "pink"]
)
@pytest.mark.parametrize(
    "surface", [(0.5, 0.4, 0.3), (0.06, 0.05, 0.05), (0.9, 0.92, 0.95), (0.1, 0.2, 0.8)]
)
def test_paint_has_the_colour_it_is_named_after(colour, surface):
    rgb = read_colour([colour])[0].rgb
    middle = paint(shaded(surface), ONES, rgb)[0, :, 8, 8]
    difference = abs(hue(middle) - hue(torch.tensor(rgb)))
    assert min(difference, 1 - difference) < 0.06
    assert (middle - torch.tensor(rgb)).abs().max() < 0.25


@pytest.mark.parametrize(
    "colour, low, high", [("black", 0, 25), ("white", 85, 100), ("grey", 40, 65)]
)
@pytest.mark.parametrize(
    "surface", [(0.7, 0.1, 0.1), (0.05, 0.05, 0.05), (0.9, 0.9, 0.95)]
)
def test_black_white_and_grey_have_their_lightness_and_little_colour(
    colour, low, high, surface
):
    lab = kornia.color.rgb_to_lab(
        paint(shaded(surface), ONES, read_colour([colour])[0].rgb)
    )[0, :, 8, 8]
    assert low <= lab[0] <= high
    assert lab[1:].norm() < 12


def test_paint_gives_one_colour_one_result_in_all_views():
    """View 1 shows the surface of view 0 half in shade: where colours are equal, results are
    equal.
    """
    views = torch.cat((shaded(), shaded()), 0)
    views[1, :, :8] *= 0.5
    result = paint(views, torch.ones(2, 16, 16), (0.8, 0.1, 0.1))
    assert torch.equal(result[0, :, 8:], result[1, :, 8:])


def test_paint_is_measured_under_the_masks_only():
    image = shaded()
    image[..., 8:, :] = 0.9
    mask = torch.zeros(1, 16, 16)
    mask[:, :8] = 1
    expected = paint(shaded(), ONES, (0.8, 0.1, 0.1))
    assert torch.allclose(
        paint(image, mask, (0.8, 0.1, 0.1))[..., :8, :], expected[..., :8, :], atol=1e-5
    )


@settings(max_examples=30, deadline=None)
@given(st.tuples(*[st.floats(0, 1)] * 3), st.tuples(*[st.floats(0, 1)] * 3))
def test_paint_is_finite_and_in_range_for_any_colours(surface, rgb):
    result = paint(shaded(surface), ONES, rgb)
    assert torch.isfinite(result).all() and result.min() >= 0 and result.max() <= 1


def test_paint_under_an_empty_mask_still_works():
    assert torch.isfinite(
        paint(shaded(), torch.zeros(1, 16, 16), (1.0, 0.0, 0.0))
    ).all()


@pytest.mark.parametrize("amount", [-1.7, -1.0, -0.5, 0.5, 1.0, 1.7])
@pytest.mark.parametrize(
    "what",
    ["brightness", "contrast", "saturation", "warmth", "greyscale", "sepia", "invert"],
)
def test_adjustments_stay_in_range_also_on_black_and_white(what, amount):
    image = torch.rand(1, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    image[..., 0, :], image[..., 1, :] = 0, 1
    result = apply_change(image, ONES, Change(what, amount=amount), RecolorParameters())
    assert torch.isfinite(result).all() and result.min() >= 0 and result.max() <= 1


def measured(what: str, image: torch.Tensor) -> float:
    red, green, blue = image.mean((0, 2, 3))
    spread = (image.amax(1) - image.amin(1)).mean()
    values = {
        "brightness": red + green + blue,
        "contrast": image.std(),
        "saturation": spread,
        "warmth": red - blue,
    }
    return float(values[what])


@pytest.mark.parametrize("what", ["brightness", "contrast", "saturation", "warmth"])
def test_adjustments_go_the_way_they_say(what):
    image = 0.2 + 0.5 * torch.rand(
        1, 3, 16, 16, generator=torch.Generator().manual_seed(0)
    )
    values = [
        measured(
            what,
            apply_change(image, ONES, Change(what, amount=amount), RecolorParameters())
            if amount
            else image,
        )
        for amount in (-1.7, -1.0, 0, 1.0, 1.7)
    ]
    assert (
        values == sorted(values)
        and values[0] < 0.95 * values[2] < 1.05 * values[2] < values[-1]
    ) or what == "warmth"
    assert values == sorted(values) and len(set(values)) == 5


def test_warmth_keeps_luma():
    image = torch.full((1, 3, 2, 2), 0.4)
    warmer = apply_change(image, ONES, Change("warmth"), RecolorParameters())
    assert torch.allclose(
        kornia.color.rgb_to_grayscale(warmer),
        kornia.color.rgb_to_grayscale(image),
        atol=1e-6,
    )
    assert warmer[0, 0, 0, 0] > warmer[0, 2, 0, 0]


def test_tint_moves_colours_and_leaves_black_and_white():
    image = (
        torch.tensor([0.0, 0.5, 1.0])[None, None, None].expand(1, 3, 1, 3).contiguous()
    )
    result = tint(image, (0.0, 0.0, 1.0), 0.35)
    assert torch.allclose(result[..., 0], image[..., 0], atol=0.01)
    assert torch.allclose(result[..., 2], image[..., 2], atol=0.01)
    assert result[0, 2, 0, 1] - result[0, 1, 0, 1] > 0.1


@given(
    st.lists(st.tuples(st.floats(-10, 10), st.integers(0, 5)), min_size=1, max_size=30)
)
def test_weighted_median_is_the_median_of_repeated_values(pairs):
    repeated = sorted(value for value, count in pairs for _ in range(count))
    if not repeated:
        return
    values, counts = zip(*pairs)
    found = weighted_median(
        torch.tensor(values, dtype=torch.float64),
        torch.tensor(counts, dtype=torch.float64),
    )
    assert found in (repeated[(len(repeated) - 1) // 2], repeated[len(repeated) // 2])
