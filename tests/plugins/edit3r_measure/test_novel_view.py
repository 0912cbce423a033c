import json
import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from edit3r_measure.evaluate_scenes import as_markdown, as_records
from edit3r_measure.novel_view import (
    best_blurred_copy,
    carried_edit,
    novel_view,
    relative_pose,
    score_scene,
    views_of,
)
from edit3r_measure.scene_sources import (
    SceneOptions,
    find_scenes,
    photo_scene,
)
from scipy.ndimage import gaussian_filter

from edit3r.cli.main import main
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Reconstructor
from edit3r.kit.photos.posed_folder import read_posed_folder
from edit3r.kit.reconstructing import WithMatcher
from edit3r.loading.registry import build, default_registry


def test_photos_without_a_pose_are_left_out(folder):
    assert [camera.file for camera in folder.cameras] == ["0.png", "1.png", "2.png"]


def test_the_centre_square_sees_the_same_rays(folder):
    photo = folder.load(0, 32)
    assert photo.image.shape == (32, 32, 3)
    # 64 of 96 columns are kept: the middle stays, the focal length counts in smaller widths.
    lens = np.array([[80 / 64, 0, 0.5], [0, 80 / 64, 0.5], [0, 0, 1]])
    assert photo.intrinsics == pytest.approx(lens)


def test_a_folder_without_cameras_names_what_is_expected(tmp_path):
    with pytest.raises(InputError, match=r"cameras\.json or a transforms\.json"):
        read_posed_folder(tmp_path)


def test_transforms_json_is_read_with_opencv_axes(tmp_path):
    pose = np.diag([1.0, -1, -1, 1]).tolist()
    frames = [{"file_path": "a.png", "transform_matrix": pose}]
    lens = {"w": 96, "h": 64, "fl_x": 80, "fl_y": 80, "cx": 48, "cy": 32}
    (tmp_path / "transforms.json").write_text(json.dumps(lens | {"frames": frames}))
    assert np.allclose(read_posed_folder(tmp_path).cameras[0].c2w, np.eye(4))


def test_true_geometry_in_another_unit_scores_well(folder, wall):
    measure = partial(novel_view, wall.Known(folder), build("rasterizer", "torch"))
    score = score_scene(photo_scene(folder, (0, 2, 1), 48), "novel view", measure)
    figures = score.figures
    assert score.degrees == pytest.approx(8) and not score.failure
    assert figures["rotation_error"] < 0.01 and figures["direction_error"] < 0.05
    assert figures["psnr"] > figures["blurred_psnr"]
    assert 0.7 < figures["coverage"] < 1


def test_a_failure_is_a_row_not_a_stop(folder, wall):
    scene = photo_scene(folder, (0, 2, 1), 48)
    failing = wall.Known(folder, fails=True)
    figures = partial(novel_view, failing, build("rasterizer", "torch"))
    score = score_scene(scene, "novel view", figures)
    assert score.failure == "nothing in common."
    table = as_markdown([score])
    assert "| wall | 1 | 1 |" in table
    assert "0.png and 2.png: nothing in common." in table
    assert as_records([score])[0]["failure"] == score.failure


def test_the_command_writes_a_table(folder, tmp_path, capsys):
    out = tmp_path / "scores.json"
    options = "--recon classical --rasterizer numba --size 64 --pairs 1 --quiet"
    assert main(f"evaluate {folder.path} {options} --out {out}".split()) == 0
    assert "| all pairs | 1 |" in capsys.readouterr().out
    assert json.loads(out.read_text())[0]["scene"] == "wall"


def test_a_pair_of_a_folder_is_named_and_brings_the_photo_between(folder):
    options = SceneOptions(count=1, size=64)
    (source,) = find_scenes(str(folder.path), options, default_registry())
    scene = source.load()
    assert source.name == "wall-64-0-2"
    assert scene.files == ("0.png", "2.png", "1.png")
    assert scene.target.image.shape == (64, 64, 3)


def test_a_folder_without_pairs_is_an_error(tmp_path, wall):
    cameras = wall.written(tmp_path, [wall.camera(0, 0)])
    (tmp_path / "cameras.json").write_text(json.dumps(cameras))
    with pytest.raises(InputError, match="no two photos are 5 to 30 degrees apart"):
        find_scenes(str(tmp_path), SceneOptions(1, 32), default_registry())


class Carries(Reconstructor):
    """Knows a generated scene's poses and true edit, and shows the edit in both views when the
    first one does.
    """

    def __init__(self, scene, carries):
        lifted = build("reconstructor", "classical")
        self.posed = WithMatcher(lifted, build("matcher", "posed"))
        poses = [relative_pose(photo, scene.inputs[0]) for photo in scene.inputs]
        self.c2w = torch.from_numpy(np.stack(poses)).float()[None]
        self.carries = carries
        self.edited = views_of(scene.edited[:2]).images

    def __call__(self, views, source=None, geometry=None, grid=None):
        is_edited = not torch.equal(views.images[:, 0], source.images[:, 0])
        images = self.edited if self.carries and is_edited else source.images
        return self.posed(replace(views, images=images, c2w=self.c2w))


@pytest.fixture(scope="module")
def edited_scene():
    settings = {"image_size": 64, "targets": 1, "edit": "recolor", "seed": 4}
    settings["angles"] = (5, 10)
    options = SceneOptions(1, 64, {"procedural": settings})
    return find_scenes("procedural", options, default_registry())[0].load()


@pytest.mark.slow
def test_an_edit_that_reaches_every_view_is_taken_up(edited_scene):
    carries = Carries(edited_scene, True)
    score = carried_edit(carries, build("rasterizer", "numba"), edited_scene)
    assert score["uptake"] > 0.8 and score["error"] < 0.3 and score["leak"] < 0.01
    assert score["disagreement"] < 0.2


@pytest.mark.slow
def test_an_edit_that_is_dropped_leaves_nothing(edited_scene):
    carries = Carries(edited_scene, False)
    score = carried_edit(carries, build("rasterizer", "numba"), edited_scene)
    names = ("uptake", "error", "leak", "disagreement")
    assert tuple(score[name] for name in names) == (0, 1, 0, 0)


def test_a_place_that_is_neither_folder_nor_data_set_is_one_sentence():
    sentence = "nowhere: no such folder of photos, and no dataset named 'nowhere'"
    with pytest.raises(InputError, match=sentence):
        find_scenes("nowhere", SceneOptions(1, 32), default_registry())


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ("--pairs 0", "evaluate.pairs: input should be greater than or equal to 1"),
        ("--out scores.csv", "ends in .md or .json"),
        ("--set editor.steps=3", "evaluate.editor: unknown setting"),
    ],
)
def test_wrong_use_of_the_command_is_one_sentence(folder, options, sentence, capsys):
    asked = f"evaluate {folder.path} --recon classical {options}"
    assert main(asked.split()) == 2
    assert sentence in capsys.readouterr().err


def test_best_blurred_copy_finds_photo_and_blur():
    other, picture = np.random.default_rng(1).random((2, 32, 40, 3)).astype(np.float32)
    blurred = gaussian_filter(picture, (2, 2, 0))
    best_psnr, best_ssim = best_blurred_copy((other, picture), blurred)
    # that very blur was among those tried
    assert math.isinf(best_psnr) and best_ssim == pytest.approx(1)
