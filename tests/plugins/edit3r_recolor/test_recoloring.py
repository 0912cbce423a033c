import json
from dataclasses import asdict

import numpy as np
import pytest
import torch
from edit3r_recolor.recoloring import (
    EPSILON,
    JITTERS,
    LEAK,
    PCA_DIRECTIONS,
    REACH,
    RecolorParameters,
    RecolorRanges,
    blend_regions,
    draw_outline,
    perturbed,
    recolor,
    renormalize,
    sample_parameters,
    with_outline,
)
from hypothesis import given, settings, strategies as st
from pydantic import TypeAdapter

GENERATOR = torch.Generator().manual_seed(0)
IMAGE = torch.rand(2, 3, 4, 5, generator=GENERATOR, dtype=torch.float64)
RECOLORED = torch.rand(3, 2, 3, 4, 5, generator=GENERATOR, dtype=torch.float64)
STRONG = RecolorRanges(brightness=1, contrast=1, saturation=1, gamma=4, lighting=2)


def sample(seed: int, ranges: RecolorRanges | None = None) -> RecolorParameters:
    return sample_parameters(
        torch.Generator().manual_seed(seed), ranges or RecolorRanges()
    )


def read_back(parameters: RecolorParameters) -> RecolorParameters:
    return TypeAdapter(RecolorParameters).validate_python(
        json.loads(json.dumps(asdict(parameters)))
    )


@given(st.integers(0, 2**31))
def test_parameters_survive_json_exactly(seed):
    parameters = sample(seed)
    assert read_back(parameters) == parameters


@given(st.integers(0, 2**31))
def test_samples_stay_in_their_ranges(seed):
    ranges = RecolorRanges(
        brightness=0.2, contrast=0.1, saturation=0.9, hue=0.3, gamma=2
    )
    drawn = sample(seed, ranges)
    assert (
        abs(drawn.brightness - 1) <= 0.2
        and abs(drawn.contrast - 1) <= 0.1
        and abs(drawn.saturation - 1) <= 0.9
    )
    assert abs(drawn.hue) <= 0.3 and 0.5 <= drawn.gamma <= 2
    assert sorted(drawn.order) == sorted(JITTERS) and sorted(drawn.permutation) == [
        0,
        1,
        2,
    ]


def test_the_seed_alone_decides():
    assert sample(7) == sample(7)
    assert len({str(sample(seed)) for seed in range(20)}) == 20


def test_ranges_of_zero_leave_colours_alone():
    ranges = {
        "brightness": 0,
        "contrast": 0,
        "saturation": 0,
        "hue": 0,
        "gamma": 1,
        "lighting": 0,
    }
    drawn = sample(
        3, RecolorRanges(**ranges, permute_probability=0, greyscale_probability=0)
    )
    assert drawn == RecolorParameters(order=drawn.order)


def test_probabilities_are_kept_over_many_samples():
    drawn = [
        sample(seed, RecolorRanges(permute_probability=1, greyscale_probability=0.25))
        for seed in range(400)
    ]
    assert 0.15 < sum(p.greyscale for p in drawn) / 400 < 0.35
    assert len({p.permutation for p in drawn}) == 6


def test_lighting_varies_most_along_the_first_direction():
    """The rows are the directions, as ImageNet's colours have them: nearly grey comes first."""
    offsets = np.array([sample(seed).lighting for seed in range(200)])
    _, sizes, axes = np.linalg.svd(offsets, full_matrices=False)
    assert abs(axes[0] @ np.array(PCA_DIRECTIONS[0])) > 0.999
    assert sizes[0] > 5 * sizes[1]


@pytest.mark.parametrize("wrong", [{"order": ("hue",)}, {"permutation": (0, 0, 1)}])
def test_impossible_orders_are_refused(wrong):
    with pytest.raises(ValueError, match="RecolorParameters"):
        RecolorParameters(**wrong)


def picture(*shape: int, dtype=torch.float32) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(1), dtype=dtype)


def test_default_parameters_change_nothing():
    image = picture(3, 5, 7, dtype=torch.float64)
    assert torch.allclose(recolor(image, RecolorParameters()), image, atol=1e-12)


@settings(max_examples=25)
@given(st.integers(0, 2**31))
def test_the_result_is_finite_and_in_range_for_any_parameters(seed):
    image = picture(2, 3, 4, 6)
    image[0, :, 0], image[0, :, 1] = 0, 1
    result = recolor(
        image, sample_parameters(torch.Generator().manual_seed(seed), STRONG)
    )
    assert result.shape == image.shape and torch.isfinite(result).all()
    assert result.min() >= 0 and result.max() <= 1


@settings(max_examples=25)
@given(st.integers(0, 2**31))
def test_a_colour_maps_to_the_same_colour_in_every_picture(seed):
    """What makes one Theta the same edit in all views: neighbours and picture size have no say."""
    parameters = sample_parameters(torch.Generator().manual_seed(seed), STRONG)
    image = picture(3, 6, 8)
    shuffled = image.flatten(1)[
        :, torch.randperm(48, generator=torch.Generator().manual_seed(seed))
    ]
    alone = recolor(image[:, 2:3, 5:6], parameters)
    assert torch.allclose(recolor(image, parameters)[:, 2:3, 5:6], alone, atol=1e-6)
    index = (shuffled - image[:, 2, 5:6]).abs().sum(0).argmin()
    assert torch.allclose(
        recolor(shuffled[:, None], parameters)[:, 0, index], alone[:, 0, 0], atol=1e-6
    )


@pytest.mark.parametrize(
    "change, before, after",
    [
        ({"brightness": 0.5}, (0.2, 0.4, 0.8), (0.1, 0.2, 0.4)),
        ({"contrast": 0.5}, (0.2, 0.5, 1.0), (0.35, 0.5, 0.75)),
        ({"gamma": 2.0}, (0.5, 1.0, 0.1), (0.25, 1.0, 0.01)),
        ({"lighting": (0.1, 0.0, -0.3)}, (0.5, 0.5, 0.2), (0.6, 0.5, 0.0)),
        ({"permutation": (2, 0, 1)}, (0.1, 0.2, 0.3), (0.3, 0.1, 0.2)),
        ({"hue": 1 / 3}, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        ({"greyscale": True}, (1.0, 0.0, 0.0), (0.299, 0.299, 0.299)),
        ({"saturation": 0.0}, (1.0, 0.0, 0.0), (0.299, 0.299, 0.299)),
    ],
)
def test_each_part_alone(change, before, after):
    image = torch.tensor(before, dtype=torch.float64)[:, None, None]
    result = recolor(image, RecolorParameters(**change))
    assert torch.allclose(
        result[:, 0, 0], torch.tensor(after, dtype=torch.float64), atol=2e-3
    )


def test_the_order_of_the_jitters_counts():
    image = picture(3, 4, 4)
    change = {"brightness": 1.4, "contrast": 0.4}
    first = recolor(
        image,
        RecolorParameters(
            **change, order=("brightness", "contrast", "saturation", "hue")
        ),
    )
    second = recolor(
        image,
        RecolorParameters(
            **change, order=("contrast", "brightness", "saturation", "hue")
        ),
    )
    assert (first - second).abs().max() > 0.1


def test_lighting_is_added_before_the_channels_change_places():
    """The paper's order: jitter, gamma, lighting, permutation, greyscale."""
    picture = torch.full((3, 2, 2), 0.5)
    given = RecolorParameters(lighting=(0.1, 0.2, 0.3), permutation=(2, 0, 1))
    shown = recolor(picture, given)[:, 0, 0]
    assert shown.tolist() == pytest.approx([0.8, 0.6, 0.7])
    dark = recolor(picture, RecolorParameters(gamma=2.0, lighting=(0.1, 0.2, 0.3)))
    assert dark[:, 0, 0].tolist() == pytest.approx([0.35, 0.45, 0.55])


def test_gradients_reach_the_image():
    image = (0.2 + 0.6 * picture(3, 2, 2, dtype=torch.float64)).requires_grad_()
    parameters = RecolorParameters(
        brightness=0.9, contrast=1.1, saturation=0.8, gamma=1.2, lighting=(0.01, 0, 0)
    )
    assert torch.autograd.gradcheck(lambda x: recolor(x, parameters), image, atol=1e-5)


def masks(regions: int) -> torch.Tensor:
    return torch.rand(
        regions,
        2,
        4,
        5,
        generator=torch.Generator().manual_seed(5),
        dtype=torch.float64,
    )


def test_blend_follows_the_equation_pixel_by_pixel():
    """I' = sum_r a_r C_r(I) + (1 - sum_r a_r) I, written out as loops."""
    given = masks(3)
    weights = renormalize(given)
    blended = blend_regions(IMAGE, RECOLORED, given)
    for view, channel, row, column in [(0, 0, 0, 0), (1, 2, 3, 4), (0, 1, 2, 2)]:
        alphas = [float(weights[r, view, row, column]) for r in range(3)]
        expected = (1 - sum(alphas)) * float(IMAGE[view, channel, row, column])
        expected += sum(
            a * float(RECOLORED[r, view, channel, row, column])
            for r, a in enumerate(alphas)
        )
        assert abs(float(blended[view, channel, row, column]) - expected) < 1e-12


def test_overlapping_binary_masks_share_a_pixel_evenly():
    overlapping = torch.ones(2, 1, 1, 1, dtype=torch.float64)
    weights = renormalize(overlapping)
    assert torch.allclose(weights, torch.full_like(weights, 1 / (2 + EPSILON)))


def test_pixels_no_mask_touches_are_bit_equal():
    given = masks(3)
    given[..., :2] = 0
    assert torch.equal(blend_regions(IMAGE, RECOLORED, given)[..., :2], IMAGE[..., :2])


@settings(max_examples=50)
@given(st.lists(st.floats(0, 1), min_size=1, max_size=6))
def test_weights_are_shares_that_sum_to_at_most_one(values):
    weights = renormalize(
        torch.tensor(values, dtype=torch.float64)[:, None, None, None]
    )
    assert (weights >= 0).all() and weights.sum() <= 1 + 1e-12
    if sum(values) > 1:
        assert weights.sum() > 1 - 2e-6
    else:  # a soft edge stays soft
        assert weights.flatten().tolist() == values


def _square(size: int) -> torch.Tensor:
    mask = torch.zeros(1, size, size)
    mask[:, size // 4 : size // 2, size // 4 : size // 2] = 1
    return mask


@pytest.mark.parametrize("size", [64, 256])
def test_outlines_move_by_the_same_share_of_the_picture_at_every_size(size):
    mask, reach = _square(size), round(size * REACH)
    side = size // 4
    assert int(with_outline(mask, "grown").sum()) == (side + 2 * reach) ** 2
    assert int(with_outline(mask, "shrunk").sum()) == (side - 2 * reach) ** 2


def test_leakage_is_limited_to_half_of_the_edit_near_the_object():
    mask = _square(64)
    leaking = with_outline(mask, "leaking")
    assert torch.equal(leaking[mask == 1], mask[mask == 1])
    outside = leaking[mask == 0]
    assert 0 < float(outside.max()) <= LEAK
    far = with_outline(with_outline(mask, "grown"), "grown") == 0
    assert not leaking[far].any()


def test_an_exact_outline_is_the_mask_itself():
    mask = torch.rand(2, 3, 9, 7, generator=torch.Generator().manual_seed(0))
    assert torch.equal(with_outline(mask, "exact"), mask)


def test_soft_masks_keep_their_shape_and_range():
    mask = torch.rand(2, 3, 20, 30, generator=torch.Generator().manual_seed(0))
    for outline in ("grown", "shrunk", "leaking"):
        spoilt = with_outline(mask, outline)
        assert (
            spoilt.shape == mask.shape
            and float(spoilt.min()) >= 0
            and float(spoilt.max()) <= 1
        )


def test_a_perturbed_palette_is_close_to_the_one_meant_and_not_the_same():
    image = torch.rand(3, 16, 16, generator=torch.Generator().manual_seed(0))
    meant = RecolorParameters(hue=0.3, brightness=0.9)
    for seed in range(5):
        off = perturbed(meant, np.random.default_rng(seed))
        change = (recolor(image, off) - recolor(image, meant)).abs().mean()
        assert 0 < float(change) < 0.08
        assert off.permutation == meant.permutation and off.greyscale == meant.greyscale


def test_every_fault_is_drawn():
    rng = np.random.default_rng(0)
    assert {draw_outline(rng) for _ in range(40)} == {"grown", "shrunk", "leaking"}
