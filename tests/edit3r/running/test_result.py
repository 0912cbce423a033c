"""What a run leaves: only what was asked for, from the command, a script or a notebook alike."""

import re
import subprocess
import sys
import warnings
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from PIL import Image

import edit3r
from edit3r.cli.main import main
from edit3r.contract.errors import QuestionError
from edit3r.contract.interfaces import (
    SUBJECT,
    Candidate,
    MaskLogits,
    Proposal,
    Reconstructor,
    Segmenter,
    Selected,
    Selection,
    Tracks,
)
from edit3r.contract.reporting import Report, warn
from edit3r.contract.types import Cameras, Reconstruction, Views
from edit3r.kit.geometry.cameras import pixel_scales, pixels_to_gaussians
from edit3r.kit.photos.images import save_image
from edit3r.running import result as result_module
from edit3r.running.config import USUAL_OUTPUTS, make_run_config
from edit3r.running.result import _other_candidates
from edit3r.running.run_folder import RunFolder
from edit3r.running.summary import answers, summary
from edit3r_testing.scenes import photograph

ALL = {
    "scene": {"scene.ply", "cameras.json"},
    "images": {"inputs", "edited", "renders"},
    **{
        "sheet": {"before_after.png"},
        "video": {"video.webm"},
        "viewer": {"viewer.html"},
        "cache": {"cache"},
    },
    "frames": {"renders"},
}
EVERY = (*USUAL_OUTPUTS, "frames")


class Wall(Reconstructor):
    """One Gaussian per pixel on the plane z = 1."""

    def __call__(self, views, source=None, geometry=None, grid=None):
        warn("the wall is flat")
        ones = torch.ones_like(views.images[:, :, 0])
        pose = torch.eye(4).expand(1, views.count, 4, 4)
        cameras = Cameras(pose, views.intrinsics, views.image_size)
        scales = pixel_scales(ones, views.intrinsics, 0.5)
        made = pixels_to_gaussians(views.images, ones, cameras, scales, 0.9 * ones)
        return Reconstruction(made, cameras)


@pytest.fixture
def photos(tmp_path):
    torch.manual_seed(0)
    (tmp_path / "photos").mkdir()
    for name in "ab":
        save_image(torch.rand(3, 24, 32), tmp_path / "photos" / f"{name}.png")
    return tmp_path / "photos"


@pytest.fixture
def result(photos):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return edit3r.run(
            [photos / "a.png", photos / "b.png"],
            recon=Wall(),
            editor="none",
            fov=53,
            frames=3,
        )


def with_settings(result, **settings):
    """The same result, written with other settings."""
    result.components.config = result.config.model_copy(update=settings)
    return result


def names(folder):
    return {path.name for path in folder.iterdir() if not path.name.startswith(".")}


@pytest.mark.parametrize(
    "asked", [(), ("viewer",), ("scene", "images"), ("frames",), EVERY]
)
def test_what_is_not_asked_for_is_not_written(result, tmp_path, asked):
    asking = with_settings(result, outputs=asked)
    out = asking.save(tmp_path / "out")
    assert names(out) == {"run.json"}.union(*(ALL[name] for name in asked))
    if "renders" in names(out):
        frames = {path.name for path in (out / "renders").glob("path_*")}
        assert bool(frames) == ("frames" in asked) and (
            (out / "renders" / "a.png").exists()
        ) == ("images" in asked)


def test_by_default_the_frames_of_the_video_are_not_left_as_pictures(result, tmp_path):
    assert names(result.save(tmp_path / "out")) == set().union(
        {"run.json"}, *ALL.values()
    )
    assert not list((tmp_path / "out" / "renders").glob("path_*"))


def test_lists_are_read_as_the_command_line_gives_them():
    assert make_run_config({"outputs": "viewer, scene"}).outputs == ("viewer", "scene")
    assert make_run_config({"outputs": "all"}).outputs == EVERY
    assert make_run_config({"export": "glb,ply"}).export == ("glb", "ply")


@pytest.mark.parametrize("flag", ["--outputs", "--export"])
@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ("film", "viewer"),
        ("film", "spz"),
        ("film", "The run itself writes scene, images"),
        ("scene,ply", "ply and scene both write scene.ply"),
    ],
)
def test_outputs_that_cannot_be_end_the_command_before_any_work(
    capsys, photos, tmp_path, flag, asked, told
):
    out = tmp_path / "out"
    assert main(["run", str(photos), flag, asked, "--out", str(out)]) == 2
    assert told in capsys.readouterr().err and not out.exists()


def test_a_saved_result_is_a_run_that_can_be_continued(result, tmp_path):
    earlier = RunFolder(result.save(tmp_path / "out")).read().inputs
    assert (
        earlier.photos.names == ("a", "b")
        and earlier.before.gaussians.count == result.gaussians.count
    )


@pytest.mark.parametrize("setting", ["outputs", "export"])
def test_a_run_writes_by_any_writer(result, tmp_path, setting):
    exporting = with_settings(result, **{setting: ("glb", "colmap")})
    assert {"scene.glb", "scene-colmap"} <= names(exporting.save(tmp_path / "out"))


def test_frames_are_drawn_once_for_the_video_and_the_pictures(result, tmp_path):
    """And the pictures are of the whole path, however much of it a writer took."""
    drawn = []
    rasterizer = result.rasterizer
    plainly = rasterizer.render
    rasterizer.render = lambda *args: drawn.append(args) or plainly(*args)
    out = with_settings(result, outputs=("video", "frames")).save(tmp_path / "out")
    assert len(drawn) == len(list((out / "renders").iterdir())) == 3
    drawn.clear()
    with_settings(result, outputs=("video",)).save(tmp_path / "video")
    with_settings(result, outputs=("sheet", "viewer")).save(tmp_path / "none")
    assert len(drawn) == 3


def test_the_camera_path_begins_at_the_first_photo_however_ill_it_fits(
    photos, tmp_path, monkeypatch
):
    save_image(torch.rand(3, 24, 32), photos / "c.png")
    made = edit3r.run(
        photos, recon=Wall(), editor="none", fov=53, frames=3, report=Report()
    )
    judged = made.records.judged
    along = []
    plainly = result_module.path_around
    monkeypatch.setattr(
        result_module,
        "path_around",
        lambda *args: along.append(args[0]) or plainly(*args),
    )
    for agreement, count in (((9, 9, 30), 2), ((9, 30, 30), 3), ((30, 9, 9), 3)):
        verdict = replace(judged.verdict, agreement=tuple(map(float, agreement)))
        records = replace(made.records, judged=replace(judged, verdict=verdict))
        replace(made, records=records).save(tmp_path / f"{agreement}")
        assert along.pop().c2w.shape[1] == count


@pytest.mark.parametrize(
    ("asked", "named"),
    [
        ({"seed": 3, "prompt": "warmer"}, "default settings, 32x24:"),
        ({"quality": "fast"}, "fast settings, 32x24:"),
        ({"quality": "fast", "refine": 5}, "fast (but refine) settings, 32x24:"),
        (
            {"quality": "best", "exposure": "own"},
            "best (but exposure) settings, 32x24:",
        ),
        ({"size": 192, "refine": 0}, "custom (refine, size) settings, 32x24:"),
        (
            {"reconstructor": {"name": "edit3r", "weights": "x"}},
            "custom (reconstructor) settings",
        ),
    ],
)
def test_the_last_lines_name_the_settings_that_were_asked_for(
    result, tmp_path, asked, named
):
    job = replace(result.components.job, config=make_run_config(asked))
    result.components.job = job
    assert named in summary(tmp_path, result)


def test_the_last_line_says_how_to_get_a_default_run_sharper(result, tmp_path):
    def last(label="good", longest=None, **asked):
        judged = replace(result.records.judged.verdict, label=label)
        records = replace(
            result.records,
            judged=replace(result.records.judged, verdict=judged),
            inputs=replace(
                result.records.inputs,
                files=(SimpleNamespace(size=(24, longest)),) if longest else (),
            ),
        )
        job = replace(result.components.job, config=make_run_config(asked))
        components = SimpleNamespace(job=job, refine_poses=False)
        made = replace(result, records=records, components=components)
        return summary(tmp_path, made).splitlines()[-1]

    assert last().endswith("--quality best takes half as long again")
    assert last(longest=4032).endswith(
        "best scales photos to 1024 pixels and not 512, and takes two to four times as long"
    )
    assert "best shows photos at their full size, and" in last(longest=800)
    assert "half as long again" in last(longest=512)
    for kept in ({"quality": "best"}, {"size": 1024}, {"label": "poor"}):
        assert "sharper" not in last(longest=4032, **kept)


def test_a_notebook_shows_the_sheet_and_the_viewer(result):
    shown = result._repr_html_()
    assert re.search('<img [^>]*src="data:image/webp;base64,', shown)
    page = re.search('<iframe [^>]*srcdoc="([^"]*)"', shown)[1]
    assert "&lt;canvas id=&quot;scene&quot;" in page and "<" not in page


def test_view_opens_the_page_in_the_browser(result, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    page = result.view()
    assert opened == [page.as_uri()] and "<canvas" in page.read_text(encoding="utf-8")


def test_what_a_run_warns_of_reaches_python(photos):
    with pytest.warns(UserWarning, match="the wall is flat") as caught:
        edit3r.run(photos, recon=Wall(), editor="none")
    texts = [str(warning.message) for warning in caught]
    assert len(set(texts)) == len(texts)
    assert {warning.filename for warning in caught} == {__file__}


def test_outside_a_run_a_warning_is_one_of_pythons():
    with pytest.warns(UserWarning, match="alone"):
        warn("alone")


def test_reprs_are_short_and_hold_no_numbers_of_tensors(result):
    things = (result, result.photos, result.gaussians, result.cameras)
    for thing in (*things, Reconstruction(result.gaussians)):
        assert len(repr(thing)) < 300 and "tensor(" not in repr(thing)
    assert repr(
        Views(torch.zeros(1, 2, 3, 4, 5), torch.zeros(1, 2, 3, 3), ("a", "b"))
    ) == (
        "Views(images=[1, 2, 3, 4, 5], intrinsics=[1, 2, 3, 3], names=('a', 'b'), c2w=None, "
        "assumed=())"
    )
    assert repr(result).startswith("RunResult(")
    assert f"{result.gaussians.count:,} Gaussians from 2 photos" in repr(result)


def test_python_m_edit3r_is_the_command():
    done = subprocess.run(
        [sys.executable, "-m", "edit3r", "--version"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == f"edit3r {edit3r.__version__}\n"


class Doubting(Segmenter):
    """Finds a bear in the middle, 20 % sure; another one lies beside it."""

    confidence = 0.2

    def masks(self, image, clicks, box=None, before=None):
        return MaskLogits(8 * self._square(image, 0.5)[None] - 4)

    def words(self, image, text):
        found = [self._square(image, left) for left in (0.3, 0.6)]
        return tuple(Proposal(one, self.confidence) for one in found)

    def track(self, images, masks):
        return Tracks(
            masks[None].expand(len(images), -1, -1, -1) * 8 - 4,
            torch.ones(len(images), len(masks), dtype=torch.bool),
        )

    def _square(self, image, left):
        mask = torch.zeros_like(image[0])
        height, width = mask.shape
        column = round(left * width)
        mask[height // 4 : height // 2, column : column + width // 4] = 1
        return mask


class Sure(Doubting):
    confidence = 0.99


class WallOfTwo(Wall):
    """Could not place the first of three photos."""

    def __call__(self, views, source=None, geometry=None, grid=None):
        placed = torch.tensor([[False, True, True]])
        return replace(super().__call__(views, source, geometry, grid), placed=placed)


def test_things_are_judged_and_drawn_on_the_photos_that_were_placed():
    views = replace(photograph(3, (48, 64)).views, names=("a", "b", "c"))
    result = edit3r.run(
        views,
        "paint the bear red",
        segmenter=Doubting(),
        recon=WallOfTwo(),
        guess=True,
        refine=0,
        gaussians="all",
        report=Report(),
    )
    assert result.photos.names == ("b", "c")
    (bear,) = result.records.selection.selected
    assert len(bear.masks) == len(bear.how) == 2
    assert all(one.view in (0, 1) for one in bear.candidates)
    assert result.edit_verdict.measures["shared"] is not None
    # of the photo that was left out nothing is known
    assert [one is None for one in result.verdict.unlike_between] == [
        True,
        False,
        False,
    ]


def test_what_was_found_unsurely_is_a_question_with_candidates_and_no_doubt_of_the_edit(
    tmp_path,
):
    views = photograph(2, (48, 64)).views
    views = replace(views, names=("a", "b"))
    asked = {"segmenter": Doubting(), "recon": Wall(), "refine": 0, "gaussians": "all"}
    asked |= {"outputs": ["sheet"]}
    report = Report()
    with pytest.raises(
        QuestionError, match=r"--candidate 1, 2 or 3.*--guess"
    ) as question:
        edit3r.run(views, "paint the bear red", report=Report(), **asked)
    assert [one.number for one in question.value.candidates] == [1, 2, 3]
    doubtful = edit3r.run(
        views, "paint the bear red", report=report, guess=True, **asked
    )
    asks = doubtful.selection_verdict
    # The other photo confirms it in part only.
    assert asks.label == "question" and asks.confidence == pytest.approx(
        0.165, abs=1e-3
    )
    assert asks.candidates == (2, 3) and "bear, confidence 17%" in asks.reason
    assert "--candidate 2" in asks.reason
    sure = edit3r.run(views, "paint the bear red", **asked | {"segmenter": Sure()})
    assert sure.selection_verdict.confidence > asks.confidence + 0.2
    of_edits = [one.edit_verdict for one in (sure, doubtful)]
    assert of_edits[0].label == of_edits[1].label
    assert all("confidence" not in one.reason for one in of_edits)
    assert any(
        "'bear' was found" in text and "--candidate 2" in text
        for text in report.warnings
    )
    second = edit3r.run(
        views, "paint the bear red", candidate=2, report=Report(), **asked
    )
    assert second.selection_verdict.confidence is None  # somebody took it
    left, right = (one.masks[0, 0].argmax(1).max() for one in (doubtful, second))
    assert left < right  # the other bear
    marked = Selection(masks=dict(enumerate(doubtful.masks[0])))
    plain = edit3r.run(views, "paint it red", masks=marked, report=Report(), **asked)
    heights = [
        Image.open(one.save(tmp_path / name) / "before_after.png").height
        for name, one in (("doubtful", doubtful), ("plain", plain))
    ]
    assert heights[0] > heights[1] + 40  # candidates below
    said = answers(doubtful.records.selection, doubtful.edit_verdict)
    assert "if it is the right thing" in said[1]


class Unknowing(Doubting):
    """Knows no words, only what stands out, and notes which pictures it was asked about."""

    def __init__(self):
        self.asked = set()

    def masks(self, image, clicks, box=None, before=None):
        self.asked.add(float(image.mean()))
        return super().masks(image, clicks, box, before)

    def words(self, image, text):
        return super().words(image, text) if text == SUBJECT else None


@pytest.mark.parametrize(
    "sentence",
    ["paint the plinth red", "everything but the plinth black and white"],
)
def test_of_words_that_nothing_knows_is_asked_by_the_first_photo_alone(sentence):
    views, segmenter = photograph(2, (48, 64)).views, Unknowing()
    with pytest.raises(QuestionError, match="what is meant by 'plinth'") as question:
        edit3r.run(views, sentence, segmenter=segmenter, recon=Wall())
    assert segmenter.asked == {float(views.images[0, 0].mean())}
    (plinth,) = question.value.preview.selection.selected
    assert plinth.taken == 0  # no candidate is drawn as the one that was taken


def test_other_candidates_are_drawn_on_the_photo_they_are_of_where_one_was_not_placed():
    mask = torch.ones(4, 6)
    unsure = Selected(
        torch.ones(2, 1, 4, 6),
        ("words", "words"),
        confidence=0.2,
        candidates=(Candidate(1, mask, 0.6, 1), Candidate(1, mask, 0.4, 2)),
    )
    photo = torch.rand(1, 1, 3, 4, 6)
    photos = Views(photo, torch.eye(3)[None, None], ("second",))
    (drawn,) = _other_candidates((unsure.select([1]),), photos)
    assert drawn.name == "second" and torch.equal(drawn.photo, photo[0, 0])
    assert [*drawn.masks] == ["--candidate 1 (taken)", "--candidate 2"]
