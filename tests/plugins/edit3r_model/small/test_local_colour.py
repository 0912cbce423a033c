import torch
from edit3r_model.small.blocks import convex_upsample
from edit3r_model.small.local_colour import change_of, fit_colour_maps

torch.manual_seed(0)
PHOTOS = torch.rand(2, 3, 16, 16)


def test_an_unedited_photo_has_maps_of_exactly_zero():
    assert (fit_colour_maps(PHOTOS, PHOTOS) == 0).all()


def test_an_affine_recoloring_is_found_and_reproduced():
    matrix = torch.tensor([[0.2, 0.7, 0.0], [0.5, 0.3, 0.1], [0.0, 0.2, 0.6]])
    edited = torch.einsum("ij,bjhw->bihw", matrix, PHOTOS) + 0.1
    maps = fit_colour_maps(PHOTOS, edited, sigma=2.0, ridge=1e-6)
    assert torch.allclose(PHOTOS + change_of(maps, PHOTOS), edited, atol=1e-3)


def test_a_plain_surface_gets_the_offset_and_no_slope():
    photos = torch.full((1, 3, 8, 8), 0.4)
    maps = fit_colour_maps(photos, photos + 0.2)
    assert maps[:, :9].abs().max() < 1e-3
    assert torch.allclose(maps[:, 9:], torch.full((1, 3, 8, 8), 0.2), atol=1e-4)


def test_stride_gives_one_map_a_cell():
    assert fit_colour_maps(PHOTOS, 1 - PHOTOS, stride=4).shape == (2, 12, 4, 4)


def test_convex_upsampling_stays_between_neighbours_and_picks_the_one_it_is_told():
    values = torch.rand(1, 2, 5, 5)
    fine = convex_upsample(values, torch.randn(1, 36, 5, 5))
    assert fine.shape == (1, 2, 10, 10)
    assert fine.min() >= values.min() and fine.max() <= values.max()
    logits = torch.full((1, 36, 5, 5), -50.0)
    logits[:, 16:20] = 50.0  # the centre neighbour for all four fine pixels
    nearest = torch.nn.functional.interpolate(values, scale_factor=2, mode="nearest")
    assert torch.allclose(convex_upsample(values, logits), nearest)
