"""Nothing shows outside the cells it is said to reach, whatever the rasterizer is set to."""

from dataclasses import replace

import pytest
import torch
from edit3r_refiners import footprint as reach
from edit3r_refiners.footprint import Footprint, Outlines, cells_of, measured_footprint, pixels_of

import edit3r
from edit3r.testing.scenes import cameras_around, gaussian_cloud

SETTINGS = [{}, {"eps2d": 10.0}, {"min_alpha": 1e-4}, {"eps2d": 0.01, "min_alpha": 0.3}]
SIZE = (66, 97)


@pytest.fixture(params=SETTINGS, ids=str)
def any_rasterizer(request):
    return edit3r.build("rasterizer", "numba", threads=1, **request.param)


def small_cloud(count, seed):
    cloud = gaussian_cloud(count, seed=seed)
    return replace(cloud, scales=cloud.scales * 0.15)


def test_nothing_shows_outside_its_cells(any_rasterizer):
    cameras, cloud = cameras_around(2, SIZE), small_cloud(60, 2)
    footprint = measured_footprint(any_rasterizer, cloud.means)
    seen = 0
    for index in range(cloud.count):
        one = cloud.select(torch.tensor([index]))
        for camera in range(cameras.count):
            shown = any_rasterizer.render(one, cameras.select([camera])).alphas[0, 0, 0] > 0
            cells = Outlines(one, footprint).cells(cameras, camera)
            assert not (shown & ~pixels_of(cells, SIZE)).any()
            assert len(Outlines(one, footprint).meeting(cameras, camera, cells)) == bool(cells.any())
            seen += bool(shown.any()) and not bool(cells.all())
    assert seen > 20


def test_those_that_do_not_meet_the_cells_add_nothing_there(any_rasterizer):
    cameras, cloud = cameras_around(1, SIZE), small_cloud(400, 3)
    footprint = measured_footprint(any_rasterizer, cloud.means)
    cells = torch.zeros(33, 49, dtype=torch.bool)
    cells[8:18, 20:28] = cells[24, 4] = True
    near = Outlines(cloud, footprint).meeting(cameras, 0, cells)
    part, whole = (any_rasterizer.render(some, cameras).images[0, 0] for some in (cloud.select(near), cloud))
    inside = pixels_of(cells, SIZE)
    assert torch.equal(part[:, inside], whole[:, inside]) and 0 < len(near) < cloud.count


@pytest.mark.parametrize("seed", range(4))
def test_trying_neighbours_as_one_first_loses_and_adds_none(monkeypatch, seed):
    generator = torch.Generator().manual_seed(seed)
    cloud = small_cloud(300, seed)  # a line through all depths, close to the cameras and behind them too
    line = torch.linspace(-3, 3, 300)[:, None] * torch.randn(3, generator=generator)
    cloud = replace(cloud, means=cloud.means * 0.05 + line)
    cameras, footprint = cameras_around(3, SIZE), Footprint(3.0, 0.3)
    cells = torch.rand(33, 49, generator=generator) > 0.99
    found = {}
    for size in (1, 7, 64):
        monkeypatch.setattr(reach, "BLOCK", size)
        found[size] = [Outlines(cloud, footprint).meeting(cameras, index, cells).tolist() for index in range(3)]
    assert found[1] == found[7] == found[64] and 0 < sum(map(len, found[1])) < 900


def test_gaussians_behind_the_camera_reach_nothing_and_close_ones_everything(rasterizer):
    camera = cameras_around(1, SIZE)
    footprint = measured_footprint(rasterizer, camera.c2w)
    ahead = camera.c2w[0, 0, :3, 2]
    places = camera.c2w[0, 0, :3, 3] + torch.tensor([[-1.0], [0.05]]) * ahead
    two = replace(small_cloud(2, 0), means=places[None], scales=torch.full((1, 2, 3), 0.02))
    behind, close = (Outlines(two.select(torch.tensor([i])), footprint).cells(camera, 0) for i in (0, 1))
    assert not behind.any() and close.all()


def test_a_rasterizer_that_draws_without_bound_has_no_footprint(any_rasterizer):
    class Boundless:
        def render(self, gaussians, cameras):
            rendering = any_rasterizer.render(gaussians, cameras)
            return replace(rendering, alphas=torch.ones_like(rendering.alphas))

    assert measured_footprint(Boundless(), torch.zeros(1)) is None


def test_a_rasterizer_that_does_not_draw_the_probe_has_no_footprint():
    far_off = edit3r.build("rasterizer", "numba", threads=1, near=5.0)
    assert measured_footprint(far_off, torch.zeros(1)) is None


def test_cells_hold_their_pixels():
    pixels = torch.zeros(SIZE, dtype=torch.bool)
    pixels[65, 96] = pixels[3, 4] = True
    cells = cells_of(pixels)
    assert cells.shape == (33, 49) and cells.nonzero().tolist() == [[1, 2], [32, 48]]
    assert pixels_of(cells, SIZE).sum() == 4 + 2
