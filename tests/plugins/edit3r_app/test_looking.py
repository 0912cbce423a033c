"""What a draft means: masks on every photo, the sentence as it is read, the 2D edit at once."""

import io
import time
from concurrent.futures import wait
from functools import partial
from pathlib import Path
from threading import Event, Thread
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from edit3r_app import looking, uploads
from edit3r_app.draft import Draft, Mark, Step
from edit3r_app.jobs import PREVIEW, JobsFolder, manifest_of
from edit3r_app.looking import Looker
from PIL import Image

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Selected, Selector
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.settings import PartChoice
from edit3r.kit.photos.images import packaged_pair
from edit3r.loading.registry import default_registry
from edit3r.running import CACHE
from edit3r.running.config import RunConfig

SIZE = 96


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return JobsFolder(tmp_path_factory.mktemp("jobs"))


@pytest.fixture(scope="module")
def scene(folder):
    files = [Path(file) for file in packaged_pair()[0]]
    return uploads.copied(folder, "motorcycle", files)


@pytest.fixture(scope="module")
def looker(folder):
    with pytest.MonkeyPatch.context() as patch:  # a busy machine is no reason to differ
        patch.setattr(looking, "GEOMETRY_PATIENCE", 120)
        yield Looker(folder, default_registry(), SIZE)


def click(looker, scene, x=0.5, y=0.5):
    first = looker.look(scene, Draft()).views.names[0]
    return Mark("add", first, [(x, y)])


def stroke(looker, scene, kind, radius, places):
    first = looker.look(scene, Draft()).views.names[0]
    return Mark(kind, first, places, radius)


@pytest.mark.slow
def test_a_click_gives_a_mask_on_every_photo(looker, scene):
    assert looker.look(scene, Draft()).masks is None
    # on the floor, which is larger than its outline; in the middle is a part of a few pixels
    draft = Draft([click(looker, scene, 0.9, 0.7)])
    look = looker.look(scene, draft)
    assert look.marked.shape == (2, *look.views.image_size)
    assert (look.marked[0] > 0.5).any()
    assert looker.look(scene, draft) is look  # asked for again by every image
    name = look.views.names[0]
    photo = Image.open(io.BytesIO(looker.photo(scene, name)))
    drawn = [looker.overlay(scene, draft, name), looker.pointed(scene, draft, name)]
    over, alone = (Image.open(io.BytesIO(content)) for content in drawn)
    assert over.size == alone.size  # of the photo, enlarged to a window
    assert over.size[0] * photo.size[1] == over.size[1] * photo.size[0]
    assert max(over.size) >= 960
    assert (
        over.getchannel("A").getextrema()[0] < 10 < over.getchannel("A").getextrema()[1]
    )
    assert Image.open(io.BytesIO(looker.overlay(scene, Draft(), name))).size == (1, 1)
    assert Image.open(io.BytesIO(looker.reading(scene, draft, 1))).size == photo.size
    for asked in (looker.overlay, looker.pointed):
        with pytest.raises(InputError, match="no photo of that name"):
            asked(scene, draft, "../x")
    with pytest.raises(InputError, match="no such reading"):
        looker.reading(scene, draft, 9)


def test_the_segmenter_has_read_the_photos_before_the_first_click(folder, scene):
    looker = Looker(folder, default_registry(), SIZE)
    build = looker.registry.build_choice
    clicked = []

    class Watched:
        def segment_marks(self, image, marks):
            clicked.append((image, marks))
            raise InputError("nothing at this click")

    looker.registry.build_choice = lambda kind, choice, *parts: (
        Watched()
        if (kind, choice.name) == ("segmenter", "auto")
        else build(kind, choice, *parts)
    )
    images = looker.look(scene, Draft()).views.images[0]
    deadline = time.monotonic() + 60
    while len(clicked) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    for (image, marks), photo in zip(clicked, images, strict=True):
        assert torch.equal(image, photo) and marks.positive


def test_two_who_ask_at_once_get_one_component(folder):
    looker, found = Looker(folder, default_registry(), SIZE), []
    ask = partial(
        looker.registry.build_choice, "segmenter", PartChoice(name="classical")
    )
    threads = [Thread(target=lambda: found.append(ask())) for _ in range(4)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert len(found) == 4 and len(set(map(id, found))) == 1


def test_what_pointing_needs_is_loaded_once_before_there_are_photos(folder):
    looker, asked = Looker(folder, default_registry(), SIZE), []
    segmenter = SimpleNamespace(segment_text=lambda image, text: asked.append(text))
    looker.registry.build_choice = lambda *_: segmenter
    for _ in range(2):
        looker.prepare()
    looker._background.shutdown()
    assert asked == ["sky"]


def test_the_same_question_twice_at_once_is_answered_once(folder, scene, monkeypatch):
    """A press asks, and its end asks again."""
    asked = []

    class Slow(Selector):
        def select(self, views, selection, geometry=None):
            asked.append(1)
            time.sleep(0.2)
            return Selected(torch.ones(1, 1, *views.image_size), ("marked",))

    monkeypatch.setattr(Looker, "_click", lambda *_: None)
    monkeypatch.setattr(Looker, "_geometry", lambda *_: None)
    monkeypatch.setattr(looking, "usual_selector", Slow)
    looker = Looker(folder, default_registry(), SIZE)
    name = looker._open_once(scene).views.names[0]
    draft = Draft([Mark("add", name, [(0.5, 0.5)])])
    threads = [
        Thread(target=looker.pointed, args=(scene, draft, name)) for _ in range(2)
    ]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert len(asked) == 1


@pytest.mark.slow
def test_the_brush_paints_exactly_and_the_eraser_takes_away(looker, scene):
    across = [(0.2, 0.5), (0.8, 0.5)]
    paint = stroke(looker, scene, "paint", 0.05, across)
    erase = stroke(looker, scene, "erase", 0.1, [(0.5, 0.5), (0.5, 0.5)])
    look = looker.look(scene, Draft([paint]))
    height, width = look.views.image_size
    rows = (look.marked[0, :, width // 2] > 0.5).nonzero()[:, 0] + 0.5
    assert (rows - height / 2).abs().max() < 0.05 * SIZE + 1.5  # only the stroke
    assert len(rows) >= 2 * 0.05 * SIZE - 2
    assert (look.marked[1] > 0.5).any()  # carried
    erased = looker.look(scene, Draft([paint, erase])).marked
    lost = (look.marked[0] > 0.5) & (erased[0] <= 0.5)
    assert lost[height // 2, width // 2]
    assert not lost[height // 2, width // 4]


def test_photos_are_read_beside_the_users_looking_and_it_is_said_how_far(folder, scene):
    looker = Looker(folder, default_registry(), SIZE)
    began = time.monotonic()
    first = looker.begin(scene)
    assert time.monotonic() - began < 0.5
    assert not first.geometry and first.left > 0
    for _ in range(600):
        if (now := looker.begin(scene)).geometry:
            break
        time.sleep(0.1)
    assert now.left == 0 and looker.is_located(scene)


@pytest.mark.parametrize("speaks", [False, True])
def test_the_photo_that_is_shown_is_read_first_and_others_while_nobody_speaks(
    folder, scene, monkeypatch, speaks
):
    read, spoke, done = [], Event(), Event()

    def located(*_):
        spoke.wait(60)
        read.append("geometry")

    looker = Looker(folder, default_registry(), SIZE)
    monkeypatch.setattr(looker, "_click", lambda opened, view: read.append(view))
    monkeypatch.setattr(looker, "_geometry", located)
    monkeypatch.setattr(looker, "_keep_answers", lambda *_: done.set())
    opened = looker._open_once(scene)
    if speaks:
        opened.asked.set()
    spoke.set()
    assert done.wait(60)
    assert read == [0, "geometry", *([] if speaks else [1])]
    looker.photo(scene, opened.views.names[1])  # a small one in the strip
    assert len(opened.read) == 2 - speaks
    looker.photo(scene, opened.views.names[1], shown=True)
    wait(opened.read.values())
    assert read == [0, "geometry", 1]


@pytest.mark.slow
def test_geometry_is_kept_in_the_cache(looker, scene):
    opened = looker._opened(scene, tuple(looker.folder.photos(scene)))
    first = opened.geometry.result()
    with collecting(Report()):
        again = looker._geometry(opened.views, opened.cache)
    assert torch.equal(first.geometry.depths, again.geometry.depths)


def test_geometry_survives_a_restart(looker, folder, scene):
    first = looker._opened(scene, tuple(folder.photos(scene)))
    shown = first.geometry.result()
    for _ in range(100):
        if any((folder.beside(scene) / CACHE).glob("match-*")):
            break
        time.sleep(0.1)
    again = Looker(folder, default_registry(), SIZE)
    opened = again._opened(scene, tuple(folder.photos(scene)))
    found = opened.geometry.result().geometry
    assert torch.equal(found.depths, shown.geometry.depths)
    assert "match" in opened.cache.reused
    assert "match" not in opened.cache.computed


def test_words_that_nobody_knows_are_a_question(looker, scene):
    look = looker.look(scene, Draft(words="the frobnicator"))
    assert any("frobnicator" in one for one in look.told)
    assert not look.is_sure and look.masks is not None


def test_what_cannot_be_read_waits_for_no_search(looker, scene):
    """And a search that nobody waits for any more is not begun."""
    answers = []

    def ask(prompt, **more):
        draft = Draft(form={"prompt": prompt})
        answers.append(looker.look(scene, draft, **more))

    looker.look(scene, Draft())
    with looker._working:  # another is being searched for
        asking = Thread(target=ask, args=("make it nice",))
        asking.start()
        asking.join(20)
        assert not asking.is_alive() and "not understood" in answers[0].problem
        stale = Thread(
            target=ask,
            args=("paint the zeppelin red",),
            kwargs={"is_wanted": lambda: False},
        )
        stale.start()
    stale.join(20)
    assert answers[1].job is None and not answers[1].problem


def test_who_points_waits_for_no_search(looker, scene):
    draft = Draft(form={"prompt": "make the sky warmer"})
    name = looker.look(scene, Draft()).views.names[0]
    edited = partial(looker.edited, scene, draft, name)
    with looker._working:  # somebody's words are searched for
        shown = Thread(target=edited, kwargs={"found": True})
        shown.start()
        shown.join(1)
        assert shown.is_alive()  # it waits for where the edit applies
        assert looker._pointing.acquire(timeout=1)
        looker._pointing.release()
    shown.join(60)
    named = Draft(form={"prompt": "paint the zeppelin red"})
    with looker._working:
        assert len(looker.edited(scene, named, name)) < 1000  # a clear pixel, at once


@pytest.mark.parametrize(
    "sentence",
    [
        "make the background red",
        "paint everything but this red",
        "make it blue and the background red",
    ],
)
@pytest.mark.parametrize("found", [False, True])
def test_what_is_seen_before_go_is_what_go_makes(looker, scene, sentence, found):
    """Where the edit applies is no mark of the thing, of which "the background" is all else."""
    paint = stroke(looker, scene, "paint", 0.1, [(0.2, 0.2), (0.4, 0.2)])
    draft = Draft([paint], form={"prompt": sentence})
    look = looker.look(scene, draft)
    assert look.job is not None, look.problem
    whole = looking.preview(look.job, looker.registry).edit.views.images[0, 0]
    shown = looker.edited(scene, draft, look.views.names[0], found)
    image = torch.from_numpy(np.array(Image.open(io.BytesIO(shown)))) / 255
    assert (image.permute(2, 0, 1) - whole).abs().mean() < 0.06  # as JPEG


def test_a_sentence_is_said_as_it_was_read(looker, scene):
    draft = Draft([click(looker, scene)], form={"prompt": "paint it red"})
    look = looker.look(scene, draft)
    assert "red" in look.understood
    assert "recolor" in look.understood
    assert look.problem == ""


def test_the_edit_of_a_quick_editor_is_there_before_the_run(looker, folder, scene):
    paint = stroke(looker, scene, "paint", 0.2, [(0.3, 0.5), (0.7, 0.5)])
    draft = Draft([paint], form={"prompt": "paint all of it red"})
    look = looker.look(scene, draft)
    assert look.is_quick
    judged = looker.edit_verdict(look)  # before Go
    assert judged.label in ("good", "doubtful")
    looker._preview(look, "early")
    kept = manifest_of(folder.beside("early") / PREVIEW)["edit_verdict"]
    assert (kept["label"], kept["reason"]) == (judged.label, judged.reason)
    images = folder.images("early", PREVIEW)
    assert list(images) == list(look.views.names)
    edited = torch.tensor(list(Image.open(images[look.views.names[0]]).getdata()))
    red, green, _ = edited.float().mean(0)
    plain_red, plain_green, _ = look.views.images[0, 0].mean((1, 2)) * 255
    assert red - green > plain_red - plain_green + 10


def test_steps_change_what_is_selected_on_every_photo(looker, scene):
    mark = click(looker, scene)
    plain = looker.look(scene, Draft([mark]))
    areas = plain.masks.sum((1, 2))
    readings = [Draft([mark, *[Step("larger", way)] * 9]) for way in (-1, 1)]
    smaller, larger = (looker.look(scene, one).masks.sum((1, 2)) for one in readings)
    assert (smaller <= areas).all() and (areas <= larger).all()
    assert (smaller < larger).all()
    most = Draft([*readings[1].marks, Step("larger", 1)])
    assert not looker.changes(scene, readings[1], most)
    assert looker.changes(scene, *readings)

    grown = looker.look(scene, Draft([mark, Step("grow", 3)]))
    assert (grown.masks.sum((1, 2)) > areas).all()
    assert torch.equal(grown.marked, plain.marked)  # the run moves the outline


def test_the_run_selects_what_is_shown(looker, scene):
    steps = [Step("grow", 3), Step("invert")]
    draft = Draft([click(looker, scene), *steps])
    shown = looker.look(scene, draft).masks
    draft.form["prompt"] = "paint it red"
    look = looker.look(scene, draft)
    assert look.problem == ""
    assert look.job.config.invert
    assert torch.allclose(look.masks, shown, atol=1e-6)


def test_words_tell_their_confidence_and_marks_have_none(looker, scene):
    form = {"prompt": "paint the motorcycle red"}
    named = looker.look(scene, Draft(words="sky"))
    assert 0 < named.confidence <= 1
    marked = looker.look(scene, Draft([click(looker, scene)], form=form))
    assert marked.confidence is None
    assert looker.edit_verdict(looker.look(scene, Draft())) is None


def test_fetched_weights_are_used_without_a_restart(looker, scene):
    draft = Draft([click(looker, scene)])
    before = looker.look(scene, draft)
    choice = RunConfig.model_fields["rasterizer"].default
    kept = looker.registry.build_choice("rasterizer", choice)
    assert looker.registry.build_choice("rasterizer", choice) is kept
    looker.renew()
    assert looker.look(scene, draft) is not before
    assert looker.registry.build_choice("rasterizer", choice) is not kept
