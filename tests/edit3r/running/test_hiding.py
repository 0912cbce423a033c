"""What a run hides is in no file that it leaves: each is opened and searched for it.

What is hidden is a square of two colours that nothing else has, in cells of some pixels, of which
the masks leave out a rim.
"""

import base64
import io
import json
import re
import shutil
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from edit3r_app.downloads import offered_files, prepared
from edit3r_app.jobs import JobsFolder
from PIL import Image

from edit3r.cli.main import main
from edit3r.contract.errors import QuestionError
from edit3r.contract.interfaces import Candidate, Selected
from edit3r.contract.types import Views
from edit3r.kit.geometry.harmonics import dc_to_colour
from edit3r.kit.photos.images import packaged_pair
from edit3r.kit.scenes.ply import save_ply
from edit3r.kit.scenes.reading import load_scene
from edit3r.loading.registry import default_registry
from edit3r.running.components import Components
from edit3r.running.config import make_run_config
from edit3r.running.hiding import covering, without_candidates
from edit3r.running.job import RunJob, with_reader
from edit3r.running.records import Inputs, SelectedRegions
from tests.plugins.scan import scan

MAGENTA, GREEN = (1.0, 0.0, 1.0), (0.0, 1.0, 0.0)
CELL, CELLS, TOP = 3, 18, 60  # [pixels], cells along a side, rows above
LEFT = {"left": 70, "right": 62}  # columns beside the square
COLOURS = {".ply", ".glb", ".sog", ".splat", ".spz"}
TEXTS = {".json", ".edit3r-run"}
POSES = {"cameras.bin", "images.bin"}


def square(side):
    rows = slice(TOP, TOP + CELL * CELLS)
    return rows, slice(LEFT[side], LEFT[side] + CELL * CELLS)


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """Two photos with the square on them, the masks of it, and the folder of all."""
    folder = tmp_path_factory.mktemp("photos")
    # As many of each colour in every place, so that their mean is neither.
    turned = np.random.default_rng(0).random((CELLS // 2, CELLS // 2)) > 0.5
    chosen = np.kron(turned, [[1, 0], [0, 1]]) + np.kron(~turned, [[0, 1], [1, 0]])
    cells = np.where(chosen[..., None] > 0, MAGENTA, GREEN)
    texture = (255 * cells.repeat(CELL, 0).repeat(CELL, 1)).astype(np.uint8)
    for side, file in zip(("left", "right"), packaged_pair()[0]):
        photo = np.array(Image.open(file).convert("RGB").resize((222, 150)))
        mask = np.zeros(photo.shape[:2], np.uint8)
        photo[square(side)] = texture
        mask[square(side)] = np.pad(np.full(texture[2:-2, 2:-2, 0].shape, 255), 2)
        Image.fromarray(photo).save(folder / f"{side}.png")
        Image.fromarray(mask).save(folder / f"{side}-mask.png")
    return folder


def run(photos, out, *words, masks=("left", "right")):
    """The folder that a run of the two photos leaves."""
    files = [str(photos / f"{side}.png") for side in ("left", "right")]
    marks = [str(photos / f"{side}-mask.png") for side in masks]
    marked = ["--mask", *marks] if marks else []
    common = ["--fov", "41", "--refine", "4", "--frames", "2"]
    assert main(["run", *files, *marked, *common, "--out", str(out), *words]) == 0
    return out


EVERYTHING = ("--outputs", "all", "--export", "glb,mesh,nerfstudio")


@pytest.fixture(scope="module")
def hidden(photos, tmp_path_factory):
    out = tmp_path_factory.mktemp("hidden") / "out"
    return run(photos, out, "--prompt", "blur it", *EVERYTHING)


@pytest.fixture(scope="module")
def ordinary(photos, tmp_path_factory):
    out = tmp_path_factory.mktemp("ordinary") / "out"
    return run(photos, out, "--prompt", "make everything warmer", *EVERYTHING, masks=())


def colours_in(file: Path) -> np.ndarray:
    """Every colour that a file holds, [colour, 3] in [0, 1]."""
    if file.suffix in (".png", ".jpg"):
        return np.array(Image.open(file).convert("RGB")).reshape(-1, 3) / 255
    if file.suffix in (".webm", ".mp4"):
        film, frames = cv2.VideoCapture(str(file)), []
        while (frame := film.read())[0]:
            frames.append(frame[1][..., ::-1].reshape(-1, 3) / 255)
        return np.concatenate(frames)
    if file.suffix == ".html":
        return _in_page(file.read_text("utf-8"))
    if file.suffix in COLOURS:
        return _in_scene(file)
    if file.name == "points3D.bin":
        return _in_points(file.read_bytes())
    assert file.suffix in TEXTS or file.name in POSES or file.name in TEXTS, (
        f"how is {file} read?"
    )
    return np.zeros((0, 3))


def _in_page(text: str) -> np.ndarray:
    """The colours of its Gaussians, after and before the edit, and those of pictures in it."""
    pictures = re.findall(r"data:image/\w+;base64,([\w+/=]+)", text)
    decoded = [Image.open(io.BytesIO(base64.b64decode(one))) for one in pictures]
    found = [np.array(one.convert("RGB")).reshape(-1, 3) / 255 for one in decoded]
    meta = json.loads(re.search(r'id="meta"[^>]*>(.*?)</script>', text, re.S)[1])
    data = re.search(r'id="data"[^>]*>(.*?)</script>', text, re.S)[1]
    planes = np.frombuffer(zlib.decompress(base64.b64decode(data)), np.uint8)
    planes = planes.reshape(-1, meta["count"])
    after = np.cumsum(planes[6:9], 1, dtype=np.uint8)
    levels = np.concatenate((after, planes[17:20] + after), 1)
    found.append(meta["colourLow"] + meta["colourStep"] * levels.T)
    return np.concatenate(found)


def _in_points(data: bytes) -> np.ndarray:
    """Of COLMAP's points: number, place, colour, error and track of each."""
    (count,), place = np.frombuffer(data, "<u8", 1), 8
    found = np.zeros((count, 3))
    for point in range(count):
        found[point] = np.frombuffer(data, np.uint8, 3, place + 32) / 255
        place += 51 + 8 * int(np.frombuffer(data, "<u8", 1, place + 43)[0])
    assert place == len(data)
    return found


def _in_scene(file: Path) -> np.ndarray:
    head, _, body = file.read_bytes().partition(b"end_header\n")
    if b"property uchar red" not in head:
        return dc_to_colour(load_scene(file).harmonics[0, :, 0]).numpy()
    count = int(re.search(rb"element vertex (\d+)", head)[1])
    names = re.search(rb"element vertex \d+\n((?:property .*\n)+)", head)[1].split()
    kinds = {b"float": "<f4", b"uchar": "u1", b"double": "<f8"}
    pairs = zip(names[2::3], names[1::3])
    kind = np.dtype([(name.decode(), kinds[kind]) for name, kind in pairs])
    points = np.frombuffer(body, kind, count)
    return np.column_stack([points[name] for name in ("red", "green", "blue")]) / 255


def told_by(file: Path) -> int:
    """How often a file holds one of the two colours of what is to be hidden."""
    colours = colours_in(file)
    near = [np.abs(colours - one).max(1) < 0.3 for one in (MAGENTA, GREEN)]
    return int(np.logical_or(*near).sum())


def files_of(folder: Path) -> list[Path]:
    return [file for file in sorted(folder.rglob("*")) if file.is_file()]


@pytest.mark.slow
def test_no_file_of_a_run_shows_what_it_hides(hidden):
    assert [file for file in files_of(hidden) if told_by(file)] == []
    assert not (hidden / "cache").exists()


@pytest.mark.slow
def test_the_search_finds_it_in_every_kind_of_file_of_another_run(ordinary, hidden):
    """What the test before does not find is not there: here the same search finds it."""
    kept = [file for file in files_of(ordinary) if "cache" not in file.parts]
    silent = {file for file in kept if not told_by(file)}
    assert {file.suffix or file.name for file in silent} == TEXTS
    masks = {Path("masks/0/left.png"), Path("masks/0/right.png")}
    assert {file.relative_to(hidden) for file in files_of(hidden)} == masks | {
        file.relative_to(ordinary) for file in kept
    }


@pytest.mark.slow
def test_no_download_of_the_app_shows_it(hidden, ordinary, tmp_path):
    """Whatever its writers make of the run when asked; of another run, pictures and films do."""
    made, folder = {}, JobsFolder(tmp_path / "jobs")
    for name, run_folder in (("hidden", hidden), ("ordinary", ordinary)):
        shutil.copytree(run_folder, folder.root / name)
        made[name] = tmp_path / name
        for what in (one["file"] for one in offered_files(folder, name)):
            file = prepared(folder, name, what)
            if file.suffix == ".zip":
                shutil.unpack_archive(file, made[name] / what)
            else:
                (made[name] / what).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(file, made[name] / what)
    assert [file for file in files_of(made["hidden"]) if told_by(file)] == []
    told = {file.suffix for file in files_of(made["ordinary"]) if told_by(file)}
    assert {".png", ".html", ".webm", *COLOURS} <= told


@pytest.mark.slow
def test_an_edit_of_an_earlier_run_hides_it_too_and_keeps_the_edit_before(
    photos, ordinary, tmp_path, capsys
):
    marks = ["--mask", *(str(photos / f"{side}-mask.png") for side in LEFT)]
    out = tmp_path / "again"
    words = ["run", "--from", str(ordinary), "--prompt", "pixelate it", *marks]
    assert main([*words, "--refine", "4", "--out", str(out)]) == 0
    assert [file for file in files_of(out) if told_by(file)] == []
    assert "the photos that you gave and the run before still show it" in (
        capsys.readouterr().err
    )
    edited, warm = (pixels_beside(one / "edited/left.png") for one in (out, ordinary))
    assert np.array_equal(edited, warm)
    rendered = pixels_beside(out / "renders/left.png")
    unedited = pixels_beside(out / "inputs/left.png")
    warmer = (edited - unedited).mean((0, 1))
    assert np.allclose((rendered - unedited).mean((0, 1)), warmer, atol=2)
    assert np.abs(warmer).max() > 6


def pixels_beside(file):
    """The picture above what is hidden."""
    return np.array(Image.open(file).convert("RGB"))[: TOP - 10].astype(np.float32)


@pytest.mark.slow
def test_what_is_hidden_is_not_brought_back_by_undo(hidden, tmp_path, capsys):
    words = ["run", "--from", str(hidden), "--prompt", "undo", "--out"]
    assert main([*words, str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert "hid something for good" in told and "start again from the photos" in told


def shown(photos, file, *words):
    """The sheet of a preview."""
    run(photos, file.parent, "--preview", str(file), *words)
    return file


@pytest.mark.slow
def test_a_preview_shows_what_is_hidden_nowhere(photos, tmp_path):
    hiding, other = tmp_path / "hiding.png", tmp_path / "other.png"
    assert told_by(shown(photos, hiding, "--prompt", "pixelate it")) == 0
    assert told_by(shown(photos, other, "--prompt", "make it warmer")) > 0


@pytest.mark.slow
def test_a_photo_on_which_nothing_is_hidden_is_named(photos, tmp_path, capsys):
    empty = tmp_path / "empty"
    empty.mkdir()
    for side in ("left", "right"):
        Image.open(photos / f"{side}.png").save(empty / f"{side}.png")
    mask = Image.open(photos / "left-mask.png")
    mask.save(empty / "left-mask.png")
    Image.new("L", mask.size).save(empty / "right-mask.png")
    shown(empty, tmp_path / "sheet.png", "--prompt", "blur it")
    assert "photo 2 (right): nothing was hidden here" in capsys.readouterr().err


@pytest.mark.slow
def test_the_sheet_of_a_question_shows_candidates_as_grey_shapes(photos, tmp_path):
    files = [str(photos / f"{side}.png") for side in ("left", "right")]
    out = tmp_path / "out"
    words = ["run", *files, "--prompt", "blur the zorbic", "--out", str(out)]
    assert main(words) == QuestionError.exit_code
    assert told_by(tmp_path / "out-question.png") == 0


def test_a_candidate_that_was_not_taken_is_a_grey_shape_too():
    photos = Views(torch.zeros(1, 2, 3, 40, 60), torch.eye(3).expand(1, 2, 3, 3))
    taken, other = torch.zeros(2, 1, 40, 60), torch.zeros(40, 60)
    taken[0, 0, 5:10, 5:10], other[20:30, 40:50] = 1, 1
    candidates = (Candidate(0, taken[0, 0], 0.6, 1), Candidate(1, other, 0.4, 2))
    found = Selected(taken, ("guess", "geometry"), candidates=candidates)
    asked = SelectedRegions(selected=(found,))
    shown = without_candidates(Inputs(photos, photos), asked).photos.images
    grey = shown[0, :, 0] == 0.5
    assert grey[0, 5:10, 5:10].all() and grey[1, 20:30, 40:50].all()
    assert not grey[0, 20:30, 40:50].any() and not grey[1, 5:10, 5:10].any()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--strength", "0.5"], "--strength 0.5: would leave some"),
        (["--feather", "3"], "--feather 3.0: would leave some"),
        (["--edit-views", "first"], "--edit-views first: would leave some"),
        (["--editor", "looks", "--set", "editor.strength=0.5"], "hides wholly"),
    ],
)
def test_what_would_hide_a_part_is_refused_before_work(tmp_path, capsys, words, told):
    out = tmp_path / "out"
    assert main(["run", "--prompt", "blur it", *words, "--out", str(out)]) == 2
    assert told in capsys.readouterr().err and not out.exists()


def test_a_thing_of_a_given_scene_is_not_hidden(tmp_path, capsys):
    scene = tmp_path / "scan.ply"
    save_ply(scene, scan())
    words = ["run", str(scene), "--prompt", "blur it", "--point", "1:5,5", "--out"]
    assert main([*words, str(tmp_path / "out")]) == 2
    assert "of a given scene cannot be hidden" in capsys.readouterr().err


def test_a_region_is_covered_beyond_its_soft_outline_and_without_gaps():
    soft = torch.zeros(60, 60)
    soft[20:40, 20:40], soft[19, 20:40], soft[30, 30] = 1, 0.3, 0
    covered = covering(soft)
    assert set(covered.unique().tolist()) == {0, 1}
    assert covered[17:42, 18:42].all() and covered.sum() == 25 * 24


def test_what_is_hidden_goes_before_what_is_filled_in_from_other_photos():
    config = make_run_config({"prompt": "remove the car and blur the face"})
    registry = default_registry()
    asked = Components(config, registry, with_reader(RunJob(config), registry))
    assert [task.instructions[0].look for task in asked.tasks] == ["blur", ""]
    assert asked.hiding == (0,)
