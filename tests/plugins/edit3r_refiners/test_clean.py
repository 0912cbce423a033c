"""Floaters found and taken out, and nothing else."""

from dataclasses import replace

import pytest
import torch
from edit3r_refiners.api import find_floaters
from edit3r_refiners.clean import CleanSettings

import edit3r
from edit3r.cli.main import main
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import RefineInputs
from edit3r.contract.types import Gaussians, Views
from edit3r.kit.photos.camera_files import posed_cameras, write_cameras
from edit3r.kit.scenes.ply import load_ply, save_ply

from .scenes import flat_wall, textured


def with_haze(gaussians, opacity=0.4, count=5):
    """The scene, and blobs half-way to it that all cameras have in the middle of the picture."""
    haze = gaussians.select(torch.arange(count))
    means = torch.tensor([[[0.05 + 0.06 * (i - 2), 0.0, 0.9] for i in range(count)]])
    haze = replace(
        haze,
        means=means,
        scales=torch.full_like(haze.scales, 0.02),
        opacities=torch.full_like(haze.opacities, opacity),
        harmonics=torch.full_like(haze.harmonics, -1.0),
        view_index=torch.full((count,), -1),
    )
    return Gaussians.cat((gaussians, haze))


def test_what_hangs_before_the_surfaces_is_found_and_nothing_else(rasterizer):
    gaussians, cameras = flat_wall(2)
    found = find_floaters(with_haze(gaussians), cameras, rasterizer)
    places = found.found.nonzero()[:, 0] - gaussians.count
    assert places.tolist() == [0, 1, 2, 3, 4]
    assert 0 < found.changed < 0.2
    assert found.sentence.startswith(f"5 of {gaussians.count + 5:,} Gaussians are flo")
    assert f"{found.changed:.1%} of the cameras' pixels" in found.sentence


def test_a_scene_without_floaters_loses_nothing_and_says_so(rasterizer):
    gaussians, cameras, _ = textured()
    found = find_floaters(gaussians, cameras, rasterizer)
    assert not found.found.any() and found.changed == 0
    assert found.sentence.startswith("No floaters")


def test_an_opaque_thing_before_a_wall_stays(rasterizer):
    gaussians, cameras = flat_wall(2)
    thing = with_haze(gaussians, opacity=0.99)
    assert not find_floaters(thing, cameras, rasterizer).found.any()


def test_what_frays_beside_an_edge_stays(rasterizer):
    gaussians, cameras = flat_wall(2)
    thing = with_haze(gaussians, opacity=0.99)
    fringe = thing.select(torch.tensor([thing.count - 1]))
    fringe = replace(
        fringe,
        means=fringe.means + torch.tensor([0.02, 0, 0]),
        scales=0.3 * fringe.scales,
        opacities=torch.full_like(fringe.opacities, 0.3),
    )
    frayed = Gaussians.cat((thing, fringe))
    assert not find_floaters(frayed, cameras, rasterizer).found.any()
    close = CleanSettings(beside=1 / 256)
    assert find_floaters(frayed, cameras, rasterizer, close).found[-1]


def test_what_one_camera_sees_as_its_surface_stays(rasterizer):
    """Veil before a wall for the first camera; alone in the picture of the second."""
    gaussians, cameras = flat_wall(2)
    c2w = cameras.c2w.clone()
    pose = [[0.0, 0, -1, 1.0], [0, 1, 0, 0], [1, 0, 0, 0.9], [0, 0, 0, 1]]
    c2w[0, 1] = torch.tensor(pose)
    aside = replace(cameras, c2w=c2w)
    haze = with_haze(gaussians, opacity=0.3)
    assert find_floaters(haze, aside.select([0]), rasterizer).found.any()
    assert not find_floaters(haze, aside, rasterizer).found.any()


def test_what_is_solid_together_stays(rasterizer):
    """Rendered depths are means: a heap, each of it half opaque, stands before its own."""
    gaussians, cameras = flat_wall(2)
    thin = find_floaters(with_haze(gaussians, 0.3, 1), cameras, rasterizer)
    assert thin.found.sum() == 1
    heap = with_haze(gaussians, 0.3, 1)
    heap = Gaussians.cat((heap, *[heap.select(thin.found)] * 4))
    assert not find_floaters(heap, cameras, rasterizer).found.any()


def test_a_batch_is_refused(rasterizer):
    gaussians, cameras = flat_wall(1, 8)
    two = Gaussians.stack([gaussians, gaussians])
    with pytest.raises(InputError, match="clean takes one scene at a time, got a batc"):
        find_floaters(two, cameras, rasterizer)


def test_the_refiner_takes_them_out(rasterizer):
    gaussians, cameras = flat_wall(2)
    views = Views(torch.zeros(1, 2, 3, 64, 64), cameras.intrinsics)
    inputs = RefineInputs(cameras, views, rasterizer)
    cleaned = edit3r.build("refiner", "clean")(with_haze(gaussians), inputs)
    assert cleaned.count == gaussians.count
    assert torch.equal(cleaned.means, gaussians.means)


@pytest.fixture
def hazy_file(tmp_path):
    gaussians, cameras = flat_wall(2)
    save_ply(tmp_path / "scene.ply", with_haze(gaussians))
    write_cameras(tmp_path / "cameras.json", posed_cameras(cameras, ["a.png", "b.png"]))
    return tmp_path / "scene.ply"


def test_the_command_says_what_it_would_take_and_writes_nothing(hazy_file, capsys):
    beside = set(hazy_file.parent.iterdir())
    assert main(["simplify", str(hazy_file), "--clean"]) == 0
    said = capsys.readouterr().out
    assert "5 of 8,197 Gaussians are floaters" in said
    assert "Nothing was written: give --out FILE" in said
    assert set(hazy_file.parent.iterdir()) == beside


@pytest.mark.parametrize(("more", "count"), [([], 8192), (["--gaussians", "500"], 500)])
def test_the_command_takes_them_out(hazy_file, capsys, more, count):
    out = hazy_file.parent / "clean.ply"
    command = ["simplify", str(hazy_file), "--clean", *more, "--out", str(out)]
    assert main(command) == 0
    said = capsys.readouterr().out
    assert "5 of 8,197 Gaussians are floaters" in said and f"wrote {out}" in said
    left = load_ply(out)
    assert left.count == count if not more else 0 < left.count <= count
    assert (left.means[0, :, 2] > 1.5).all()


def test_a_scene_that_is_to_be_simplified_needs_a_place(hazy_file, capsys):
    assert main(["simplify", str(hazy_file)]) == 2
    assert "simplify needs --out FILE" in capsys.readouterr().err
