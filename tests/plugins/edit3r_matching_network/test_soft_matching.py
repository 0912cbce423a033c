import torch
from edit3r_matching_network.soft_matching import REACH, match_globally, match_in_window, unit_descriptors

from edit3r.geometry.cameras import pixel_grid


def _descriptors(grid, shift, dim=16, seed=0):
    """Random unit descriptors of a picture and of the same moved `shift` cells to the right: `[1, 2, dim, h, w]`."""
    wide = torch.randn(dim, grid[0], grid[1] + shift, generator=torch.Generator().manual_seed(seed))
    both = torch.stack((wide[..., shift:], wide[..., : grid[1]]))[None]
    return unit_descriptors(both, 2, torch.tensor(4.0))


def test_a_moved_picture_is_found_by_the_global_search():
    grid = (6, 8)
    tokens = _descriptors(grid, 2).flatten(3).transpose(2, 3)
    coordinates = pixel_grid(grid, tokens).flatten(0, 1)
    found = match_globally(tokens, tokens, torch.zeros(1, 48, 48), coordinates)
    moved = (found.coordinates - coordinates)[0].unflatten(1, grid)
    assert torch.allclose(moved[0, :, :-2], torch.tensor([2 / 8, 0.0]).expand(6, 6, 2), atol=0.02)
    assert torch.allclose(
        found.carried[0, 0].unflatten(0, grid)[:, :-2], tokens[0, 0].unflatten(0, grid)[:, :-2], atol=0.2
    )


def test_both_directions_are_probabilities():
    tokens = torch.randn(2, 2, 12, 5, generator=torch.Generator().manual_seed(0))
    found = match_globally(tokens, tokens, torch.zeros(2, 12, 12), torch.rand(12, 2))
    assert torch.allclose(found.log_probabilities.exp().sum(-1), torch.ones(2, 2, 12), atol=1e-5)
    assert ((found.certainty >= 0) & (found.certainty <= 1.0001)).all()


def test_a_moved_picture_is_found_in_the_window_cell_by_cell():
    grid = (12, 16)
    descriptors = _descriptors(grid, 3)
    tokens = pixel_grid((6, 8), descriptors).flatten(0, 1).expand(1, 2, -1, -1)
    found = match_in_window(descriptors, tokens)
    cells = pixel_grid(grid, descriptors)
    moved = (found.coordinates.unflatten(2, grid) - cells)[0] * 16
    assert torch.allclose(moved[0, :, 1:-5, 0], torch.full((12, 10), 3.0), atol=0.15)
    assert torch.allclose(moved[1, :, 5:-1, 0], torch.full((12, 10), -3.0), atol=0.15)


def test_cells_outside_the_picture_are_never_the_match():
    descriptors = _descriptors((12, 16), 1)
    corner = torch.zeros(1, 2, 48, 2)
    found = match_in_window(descriptors, corner)
    assert (found.corners == -REACH // 2).all()
    assert ((found.coordinates > 0) & (found.coordinates < 1)).all()


def test_places_far_outside_leave_something_to_search():
    descriptors = _descriptors((12, 16), 1)
    for far in (-5.0, 7.0):
        found = match_in_window(descriptors, torch.full((1, 2, 48, 2), far))
        assert torch.isfinite(found.coordinates).all()
        assert (found.logits.amax(-1) > -1e3).all()
