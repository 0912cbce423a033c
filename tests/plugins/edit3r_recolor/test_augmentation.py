import json

import numpy as np
import pytest
import torch
from edit3r_recolor.augmentation import LEAK, REACH, Fault, draw_outline, perturbed, with_outline
from edit3r_recolor.parameters import RecolorParameters
from edit3r_recolor.transform import recolor


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
        assert spoilt.shape == mask.shape and float(spoilt.min()) >= 0 and float(spoilt.max()) <= 1


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


@pytest.mark.parametrize("fault", [Fault(), Fault("grown", RecolorParameters(hue=0.1234567890123))])
def test_faults_survive_json(fault):
    assert Fault.from_json(json.loads(json.dumps(fault.to_json()))) == fault
