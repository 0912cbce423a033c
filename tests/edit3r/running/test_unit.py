"""A run with given poses is the same run in any unit, and answers in the given one."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import edit3r
from edit3r.contract.reporting import Report
from edit3r.contract.types import Cameras, Reconstruction, Rendering, Views
from edit3r.kit.cache import Cache
from edit3r.kit.photos.camera_files import posed_cameras, write_cameras
from edit3r.kit.photos.images import save_image
from edit3r.kit.scenes.ply import load_ply
from edit3r.running.records import (
    EditedPhotos,
    ExposureCorrected,
    Inputs,
    Judged,
    Located,
    Reconstructed,
    Records,
    SelectedRegions,
)
from edit3r.running.result import RunResult
from edit3r.running.steps.read import _in_own_unit
from edit3r.running.unit import has_given_poses, own_unit

pytestmark = pytest.mark.slow

SMALL = 2.0**-9  # of the unit in which the cameras stand about 1 apart: depths of 0.006


def views(distance):
    poses = torch.eye(4).repeat(1, 3, 1, 1)
    poses[0, 1, 0, 3], poses[0, 2, 1, 3] = distance, 2 * distance
    lens = torch.eye(3).repeat(1, 3, 1, 1)
    return Views(torch.rand(1, 3, 3, 4, 5), lens, c2w=poses)


def result_of(inputs, made, refined=False):
    """Of a run whose reconstruction is `made`."""
    count = inputs.photos.count
    maps = torch.ones(len(inputs.photos.images), count, 1, 4, 5)
    shown = Rendering(inputs.photos.images, maps, maps)
    records = Records(
        inputs,
        Located(),
        SelectedRegions(),
        EditedPhotos(inputs.start),
        ExposureCorrected(inputs.photos, inputs.start),
        Reconstructed(made, inputs.photos, (True,) * count),
        made.gaussians,
        Judged(shown, verdict=None, edit_verdict=None),
    )
    components = SimpleNamespace(job=SimpleNamespace(refine_poses=refined))
    return RunResult(records, components, Report(), Cache())


@pytest.mark.parametrize("distance", [1e-6, 0.003, 1.0, 40.0, 1e6])
def test_cameras_stand_about_one_apart_and_only_the_exponent_changes(distance):
    factor = own_unit(views(distance)).factor
    assert np.log2(float(factor)) % 1 == 0
    assert 0.7 < 1.5 * distance * factor < 1.42


def test_without_poses_or_distance_there_is_no_other_unit():
    assert own_unit(replace(views(1.0), c2w=None)).factor == 1
    assert own_unit(views(0.0)).factor == 1
    assert own_unit(views(0.001).select([1])).factor == 1


def test_each_scene_of_a_batch_has_the_unit_that_it_has_alone(gaussians_at):
    distances = (1.0, 1e-4, 1e6)
    alone = [views(distance) for distance in distances]
    batch = replace(
        alone[0],
        images=torch.cat([one.images for one in alone]),
        intrinsics=torch.cat([one.intrinsics for one in alone]),
        c2w=torch.cat([one.c2w for one in alone]),
    )
    factors = torch.cat([own_unit(one).factor for one in alone])
    assert torch.equal(own_unit(batch).factor, factors)
    inputs = _in_own_unit(Inputs(photos=batch, start=batch))
    assert 0.7 < inputs.photos.c2w[:, 1:, :3, 3].norm(dim=-1).mean(1).min() < 1.42
    # The second scene's poses are its own, so its answer is in no unit of the photos.
    cameras = Cameras(inputs.photos.c2w.clone(), batch.intrinsics, (4, 5))
    cameras.c2w[1, 1, 1, 3] += 0.1
    points = edit3r.Gaussians.stack([gaussians_at(3.0)] * 3)
    made = Reconstruction(points, cameras)
    back = result_of(inputs, made)
    expected = 3 / factors
    expected[1] = 3
    assert torch.allclose(back.gaussians.means[:, 0, 2].double(), expected)
    assert torch.equal(back.photos.c2w, batch.c2w)
    assert has_given_poses(Reconstruction(points, back.cameras), batch).tolist() == [
        True,
        False,
        True,
    ]


@pytest.fixture(scope="module")
def posed(tmp_path_factory):
    """Two photos of a generated scene as files, and its cameras in two units."""
    folder = tmp_path_factory.mktemp("posed")
    sample = edit3r.build(
        "dataset", "procedural", image_size=64, scenes=1, seed=3, textures=8
    )[0]
    names = [f"{index}.png" for index in range(len(sample.context))]
    for name, image in zip(names, sample.context):
        save_image(image, folder / name)
    for unit in (1.0, SMALL):
        c2w = sample.context_cameras.c2w.clone()
        c2w[..., :3, 3] *= unit / c2w[0, 1, :3, 3].norm()
        cameras = replace(sample.context_cameras, c2w=c2w)
        write_cameras(folder / f"{unit}.json", posed_cameras(cameras, names))
    return folder, [folder / name for name in names]


QUICK = {"frames": 2, "size": 64, "refine": 4}


def run(posed, unit, **asked):
    folder, photos = posed
    cameras = folder / f"{unit}.json"
    return edit3r.run(
        photos, "make everything sepia", cameras=cameras, **QUICK, **asked
    )


@pytest.fixture(scope="module")
def both(posed):
    """The same run in an ordinary unit and in a small one."""
    return run(posed, 1.0), run(posed, SMALL)


def test_the_same_scene_in_a_small_unit_is_the_same_scene(both):
    usual, small = both
    assert small.verdict.label == usual.verdict.label != "failed"
    assert torch.allclose(small.rendered.images, usual.rendered.images, atol=1e-3)
    assert torch.equal(small.edited.images, usual.edited.images)
    assert small.gaussians.count == usual.gaussians.count
    for name in ("means", "scales"):
        given, own = (getattr(one.gaussians, name) for one in (small, usual))
        assert torch.allclose(given / SMALL, own, rtol=1e-2, atol=1e-3)


def test_the_result_is_in_the_given_unit(both, posed, tmp_path):
    _, small = both
    given = json.loads((posed[0] / f"{SMALL}.json").read_text())
    apart = np.linalg.norm(np.subtract(*(np.array(c["c2w"])[:3, 3] for c in given)))
    found = small.cameras.c2w[0, 1, :3, 3].norm()
    assert float(found) == pytest.approx(apart, rel=1e-5)
    assert float(small.photos.c2w[0, 1, 0, 3]) == pytest.approx(
        given[1]["c2w"][0][3], rel=1e-6
    )
    seen = small.rendered.depths[small.rendered.alphas > 0.9]
    assert 0.001 < float(seen.median()) < 0.1
    # What draws the written scene has no run around it: its near plane follows the scene.
    scene = load_ply(small.save(tmp_path / "out") / "scene.ply", visible=True)
    drawn = edit3r.build("rasterizer", "torch").render(scene, small.cameras)
    assert torch.allclose(drawn.images, small.rendered.images, atol=0.02)


def test_editing_again_goes_on_in_the_given_unit(both):
    _, small = both
    again = edit3r.run(prompt="make everything grey", earlier=small, **QUICK)
    assert torch.allclose(again.cameras.c2w, small.cameras.c2w)
    assert again.verdict.label != "failed"
    means = [one.gaussians.means.norm(dim=-1).median() for one in (again, small)]
    assert float(means[0]) == pytest.approx(float(means[1]), rel=0.1)


def test_a_reconstructor_that_finds_poses_itself_keeps_its_unit(gaussians_at):
    """Whose answer does not stand on the given poses is not in their unit."""
    given = views(0.01)
    inputs = _in_own_unit(Inputs(photos=given, start=given))
    factor = inputs.unit.factor
    assert torch.equal(inputs.photos.c2w[..., :3, 3], factor * given.c2w[..., :3, 3])
    cameras = Cameras(inputs.photos.c2w, given.intrinsics, (4, 5))
    on_poses = Reconstruction(gaussians_at(3.0), cameras)
    other = replace(cameras, c2w=inputs.photos.c2w.clone())
    other.c2w[0, 1, 1, 3] += 0.1
    for made, expected in (
        (on_poses, 3.0 / factor),
        (replace(on_poses, cameras=other), 3.0),
    ):
        back = result_of(inputs, made)
        assert torch.equal(back.photos.c2w, given.c2w)
        assert torch.equal(back.edited.c2w, given.c2w)
        assert float(back.gaussians.means.max()) == pytest.approx(expected)
        assert has_given_poses(Reconstruction(back.gaussians, back.cameras), given) == (
            made is on_poses
        )
    refined = result_of(inputs, made, refined=True)
    assert float(refined.gaussians.means.max()) < 3


@pytest.fixture
def gaussians_at():
    def make(z):
        return edit3r.Gaussians(
            torch.tensor([[[0, 0, z]]]),
            torch.ones(1, 1, 3),
            torch.tensor([[[1.0, 0, 0, 0]]]),
            torch.ones(1, 1),
            torch.zeros(1, 1, 1, 3),
        )

    return make


def test_given_poses_far_apart_may_differ_by_as_much_more(gaussians_at):
    """By a thousandth of the distance between the cameras, in whatever unit."""
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[:, 1, 0, 3] = 1000.0
    lens = torch.eye(3).expand(1, 2, 3, 3)
    views = Views(torch.zeros(1, 2, 3, 4, 6), lens, c2w=c2w)
    for off, stands in ((0.5, True), (5.0, False)):
        moved = c2w.clone()
        moved[:, 1, 1, 3] = off
        scene = Reconstruction(gaussians_at(3.0), Cameras(moved, lens, (4, 6)))
        assert has_given_poses(scene, views).tolist() == [stands]
