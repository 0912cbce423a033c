import torch
from edit3r_model.layers import guided_upsample


def test_maps_at_the_guide_s_size_come_back_unchanged():
    maps = torch.rand(1, 4, 8, 8)
    assert guided_upsample(maps, torch.rand(1, 3, 8, 8)) is maps


def test_constant_maps_stay_constant():
    fine = guided_upsample(torch.full((1, 2, 8, 6), 0.3), torch.rand(1, 3, 32, 24))
    assert torch.allclose(fine, torch.full((1, 2, 32, 24), 0.3), atol=1e-4)


def test_a_step_follows_the_guide_s_edge_better_than_bilinear_resizing():
    guide = torch.zeros(1, 3, 64, 64)
    guide[..., 30:] = 1.0  # not on the coarse grid's lines
    truth = guide[:, :1]
    coarse = torch.nn.functional.interpolate(truth, (16, 16), mode="area")
    guided = (guided_upsample(coarse, guide) - truth).abs().mean()
    plain = torch.nn.functional.interpolate(
        coarse, (64, 64), mode="bilinear", align_corners=False
    )
    assert guided < 0.35 * (plain - truth).abs().mean()


def test_the_result_stays_within_the_neighbourhood_s_range():
    torch.manual_seed(0)
    maps = torch.rand(1, 3, 8, 8)
    fine = guided_upsample(maps, torch.rand(1, 3, 40, 40))
    assert fine.min() >= maps.min() - 1e-5 and fine.max() <= maps.max() + 1e-5
