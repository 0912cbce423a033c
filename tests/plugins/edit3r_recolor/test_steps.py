import kornia
import pytest
import torch
from edit3r_recolor.recoloring import RecolorParameters
from edit3r_recolor.steps import apply_change, tint

from edit3r.contract.instructions import Change


@pytest.mark.parametrize("amount", [-1.7, -1.0, -0.5, 0.5, 1.0, 1.7])
@pytest.mark.parametrize(
    "what",
    ["brightness", "contrast", "saturation", "warmth", "greyscale", "sepia", "invert"],
)
def test_adjustments_stay_in_range_also_on_black_and_white(what, amount):
    image = torch.rand(1, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    image[..., 0, :], image[..., 1, :] = 0, 1
    result = apply_change(image, Change(what, amount=amount), RecolorParameters())
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
            apply_change(image, Change(what, amount=amount), RecolorParameters())
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
    warmer = apply_change(image, Change("warmth"), RecolorParameters())
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
