"""A scene as triangles: where its surfaces are, in their colours, in a file that others read."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from edit3r_outputs import mesh as module
from edit3r_outputs.mesh import mesh_of

from edit3r import Cameras, Gaussians, build, save_ply
from edit3r.cli.main import main
from edit3r.contract.errors import InputError
from edit3r.kit.photos.camera_files import posed_cameras, write_cameras
from edit3r.kit.rendering import render_each

SIZE = (64, 80)
PLATE, WALL = 1.0, 2.0  # depths
RED, BLUE = (0.8, 0.1, 0.1), (0.1, 0.1, 0.8)
RASTERIZER = build("rasterizer", "torch")


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    monkeypatch.setattr(module, "CELLS", (48, 56, 40))


def plane(half, depth, count, colour):
    """Wide Gaussians on a plane that faces view 0."""
    line = torch.linspace(-half, half, count)
    y, x = torch.meshgrid(line, line, indexing="ij")
    means = torch.stack((x, y, torch.full_like(x, depth)), -1).view(1, -1, 3)
    total = means.shape[1]
    harmonics = (torch.tensor(colour) - 0.5) / 0.2820948
    return Gaussians(
        means,
        torch.full((1, total, 3), 0.014 * depth),
        torch.tensor([1.0, 0, 0, 0]).expand(1, total, 4),
        torch.full((1, total), 0.99),
        harmonics.expand(1, total, 1, 3).contiguous(),
    )


@pytest.fixture(scope="module")
def scene():
    parts = (plane(1.4, WALL, 60, BLUE), plane(0.2, PLATE, 24, RED))
    c2w = torch.eye(4).repeat(1, 3, 1, 1)
    c2w[0, :, 0, 3] = torch.tensor([0.0, 0.1, -0.1])
    lens = torch.tensor([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]]).repeat(1, 3, 1, 1)
    return Gaussians.cat(parts), Cameras(c2w, lens, SIZE)


def seen(gaussians, cameras):
    shown = render_each(RASTERIZER, gaussians, cameras, "")
    return mesh_of(shown, cameras)


def test_triangles_lie_on_the_surfaces_in_their_colours(scene):
    mesh = seen(*scene)
    x, y, z = mesh.vertices.T
    beside = np.maximum(abs(x / z), abs(y / z)) > 0.3  # of the plate and its edge
    on_plate = np.maximum(abs(x / z), abs(y / z)) < 0.15
    front = on_plate & (z < 1.5)
    for there, depth, colour in ((beside, WALL, BLUE), (front, PLATE, RED)):
        assert there.sum() >= 100
        assert np.quantile(abs(z[there] / depth - 1), 0.95) < 0.04
        assert abs(np.median(mesh.colours[there], 0) - colour).max() < 0.05
    red = mesh.colours[:, 0] > mesh.colours[:, 2] + 0.1
    # none of the wall, part of which another view hides behind the plate
    assert z[red].max() < 0.9 * WALL
    assert mesh.colours.min(1).max() < 0.9  # what no view shows is not white
    assert mesh.faces.max() < len(mesh.vertices)
    covered = np.histogram2d(x / z, y / z, 20, [[-0.45, 0.45]] * 2)[0] > 0
    assert covered.mean() > 0.97


def test_distances_are_in_steps_of_the_grid_and_add_up_over_the_views(scene):
    """On the middle ray of a wall at depth 2, which the second view sees from 3."""
    cameras = scene[1].select([0, 1])
    cameras.c2w[0, 1] = torch.eye(4)
    cameras.c2w[0, 1, 2, 3] = -1
    depths = torch.tensor([2.0, 3.0])[:, None, None].expand(2, *SIZE)
    rays = torch.tensor([[[0.0, 0, 1], [9, 0, 1]]])  # the second leaves the pictures
    frustum = module.Frustum(rays, torch.zeros(3), torch.linspace(0.2, 0.8, 31))
    total, weight = module._distances(frustum, cameras, depths)
    inverse = frustum.inverse_depths
    steps = torch.stack((inverse - 1 / 2, 1 / (1 / inverse + 1) - 1 / 3)) / 0.02
    known = steps > -module.REACH
    expected = (steps.clamp(max=module.REACH) * known).sum(0)
    torch.testing.assert_close(total[0, 0], expected, atol=1e-3, rtol=1e-3)
    assert torch.equal(weight[0, 0], known.sum(0).float()) and not weight[0, 1].any()


def test_a_scene_that_is_turned_with_its_cameras_makes_the_same_mesh(scene):
    gaussians, cameras = scene
    pose = torch.tensor([[0.0, 0, 1, 2], [0, 1, 0, -1], [-1, 0, 0, 3], [0, 0, 0, 1]])
    turn, shift = pose[:3, :3], pose[:3, 3]
    # Round Gaussians look the same when only their centres turn.
    turned = replace(gaussians, means=gaussians.means @ turn.T + shift)
    moved = replace(cameras, c2w=pose @ cameras.c2w)
    expected = seen(gaussians, cameras)
    found = seen(turned, moved)
    assert len(found.vertices) == pytest.approx(len(expected.vertices), rel=0.02)
    back = (found.vertices - shift.numpy()) @ turn.numpy()
    for quantile in (0.1, 0.5, 0.9):
        np.testing.assert_allclose(
            np.quantile(back, quantile, 0),
            np.quantile(expected.vertices, quantile, 0),
            atol=0.02,
        )


def test_the_file_holds_the_mesh_upright(scene, tmp_path, capsys):
    gaussians, cameras = scene
    save_ply(tmp_path / "scene.ply", gaussians)
    files = ["a.png", "b.png", "c.png"]
    write_cameras(tmp_path / "cameras.json", posed_cameras(cameras, files))
    assert main(f"export {tmp_path} --to mesh --quiet".split()) == 0
    content = (tmp_path / "scene-mesh.ply").read_bytes()
    head, data = content.split(b"end_header\n", 1)
    counts = [
        int(line.split()[2])
        for line in head.decode().splitlines()
        if line.startswith("element")
    ]
    assert len(data) == 15 * counts[0] + 13 * counts[1]
    vertices = np.frombuffer(data[: 15 * counts[0]], [("p", "<f4", 3), ("c", "u1", 3)])
    mesh = seen(gaussians, cameras)
    assert vertices["p"][:, 2].max() < 0  # the viewer looks along -z
    assert abs(vertices["p"].mean(0) - mesh.vertices.mean(0) * [1, -1, -1]).max() < 0.05
    corners = np.frombuffer(data[15 * counts[0] :], [("n", "u1"), ("i", "<i4", 3)])
    assert (corners["n"] == 3).all() and corners["i"].max() < counts[0]


def test_a_scene_without_a_surface_is_told(scene):
    gaussians, cameras = scene
    behind = gaussians.select(torch.arange(3))
    with pytest.raises(InputError, match="shows no surface"):
        seen(behind, cameras)
