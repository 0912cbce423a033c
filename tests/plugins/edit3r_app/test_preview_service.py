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
from edit3r_app import preview_service, uploads
from edit3r_app.draft import Draft, Mark, Step
from edit3r_app.jobs import PREVIEW, JobsFolder, manifest_of
from edit3r_app.preview_service import PreviewService
from edit3r_app.sessions import Sessions
from PIL import Image

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Candidate, Selected, Selector
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import Views
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
def previews(folder):
    with pytest.MonkeyPatch.context() as patch:  # a busy machine is no reason to differ
        patch.setattr(preview_service, "GEOMETRY_PATIENCE", 120)
        yield PreviewService(folder, default_registry(), SIZE)


def click(previews, scene, x=0.5, y=0.5):
    first = previews.look(scene, Draft()).views.names[0]
    return Mark("add", first, [(x, y)])


def stroke(previews, scene, kind, radius, places):
    first = previews.look(scene, Draft()).views.names[0]
    return Mark(kind, first, places, radius)


@pytest.mark.parametrize(
    ("marked", "said"), [(True, "what you marked: night"), (False, "whole: night")]
)
def test_what_is_said_of_all_says_so_where_marks_confine_it(
    previews, scene, marked, said
):
    square = [(0.2, 0.2), (0.6, 0.2), (0.6, 0.6)]
    draft = Draft([stroke(previews, scene, "lasso", 0, square)] if marked else [])
    draft.form["prompt"] = "make it night"
    look = previews.look(scene, draft)
    assert look.understood.startswith(said), look
    assert (look.masks is None) != marked


@pytest.mark.slow
def test_a_click_gives_a_mask_on_every_photo(previews, scene):
    assert previews.look(scene, Draft()).masks is None
    # on the floor, which is larger than its outline; in the middle is a part of a few pixels
    draft = Draft([click(previews, scene, 0.9, 0.7)])
    look = previews.look(scene, draft)
    assert look.marked.shape == (2, *look.views.image_size)
    assert (look.marked[0] > 0.5).any()
    assert previews.look(scene, draft) is look  # asked for again by every image
    name = look.views.names[0]
    photo = Image.open(io.BytesIO(previews.photo(scene, name)))
    drawn = [previews.overlay(scene, draft, name), previews.pointed(scene, draft, name)]
    over, alone = (Image.open(io.BytesIO(content)) for content in drawn)
    assert over.size == alone.size  # of the photo, enlarged to a window
    assert over.size[0] * photo.size[1] == over.size[1] * photo.size[0]
    assert max(over.size) >= 960
    assert (
        over.getchannel("A").getextrema()[0] < 10 < over.getchannel("A").getextrema()[1]
    )
    assert Image.open(io.BytesIO(previews.overlay(scene, Draft(), name))).size == (1, 1)
    assert (
        Image.open(io.BytesIO(previews.candidate(scene, draft, 1))).size == photo.size
    )
    for asked in (previews.overlay, previews.pointed):
        with pytest.raises(InputError, match="no photo of that name"):
            asked(scene, draft, "../x")
    with pytest.raises(InputError, match="no such candidate"):
        previews.candidate(scene, draft, 9)


def test_the_segmenter_has_read_the_photos_before_the_first_click(folder, scene):
    previews = PreviewService(folder, default_registry(), SIZE)
    build = previews.registry.build_choice
    clicked = []

    class Watched:
        def masks(self, image, clicks, box=None, before=None):
            clicked.append((image, clicks))
            raise InputError("nothing at this click")

    previews.registry.build_choice = lambda kind, choice, *parts: (
        Watched()
        if (kind, choice.name) == ("segmenter", "auto")
        else build(kind, choice, *parts)
    )
    images = previews.look(scene, Draft()).views.images[0]
    deadline = time.monotonic() + 60
    while len(clicked) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    for (image, clicks), photo in zip(clicked, images, strict=True):
        assert torch.equal(image, photo) and clicks == [((0.5, 0.5), True)]


def test_two_who_ask_at_once_get_one_component(folder):
    previews, found = PreviewService(folder, default_registry(), SIZE), []
    ask = partial(
        previews.registry.build_choice, "segmenter", PartChoice(name="grabcut")
    )
    threads = [Thread(target=lambda: found.append(ask())) for _ in range(4)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert len(found) == 4 and len(set(map(id, found))) == 1


def test_what_pointing_needs_is_loaded_once_before_there_are_photos(folder):
    previews, asked = PreviewService(folder, default_registry(), SIZE), []
    segmenter = SimpleNamespace(words=lambda image, text: asked.append(text))
    previews.registry.build_choice = lambda *_: segmenter
    for _ in range(2):
        previews.prepare()
    previews.sessions.background.shutdown()
    assert asked == ["sky"]


def test_the_same_question_twice_at_once_is_answered_once(folder, scene, monkeypatch):
    """A press asks, and its end asks again."""
    asked = []

    class Slow(Selector):
        def select(self, views, selection, geometry=None):
            asked.append(1)
            time.sleep(0.2)
            return Selected(torch.ones(1, 1, *views.image_size), ("marked",))

    monkeypatch.setattr(Sessions, "_click", lambda *_: None)
    monkeypatch.setattr(Sessions, "_geometry", lambda *_: None)
    monkeypatch.setattr(preview_service, "usual_selector", Slow)
    previews = PreviewService(folder, default_registry(), SIZE)
    name = previews.sessions.open(scene).views.names[0]
    draft = Draft([Mark("add", name, [(0.5, 0.5)])])
    threads = [
        Thread(target=previews.pointed, args=(scene, draft, name)) for _ in range(2)
    ]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert len(asked) == 1


@pytest.mark.slow
def test_the_brush_paints_exactly_and_the_eraser_takes_away(previews, scene):
    across = [(0.2, 0.5), (0.8, 0.5)]
    paint = stroke(previews, scene, "paint", 0.05, across)
    erase = stroke(previews, scene, "erase", 0.1, [(0.5, 0.5), (0.5, 0.5)])
    look = previews.look(scene, Draft([paint]))
    height, width = look.views.image_size
    rows = (look.marked[0, :, width // 2] > 0.5).nonzero()[:, 0] + 0.5
    assert (rows - height / 2).abs().max() < 0.05 * SIZE + 1.5  # only the stroke
    assert len(rows) >= 2 * 0.05 * SIZE - 2
    assert (look.marked[1] > 0.5).any()  # carried
    erased = previews.look(scene, Draft([paint, erase])).marked
    lost = (look.marked[0] > 0.5) & (erased[0] <= 0.5)
    assert lost[height // 2, width // 2]
    assert not lost[height // 2, width // 4]


def test_photos_are_read_beside_the_users_looking_and_it_is_said_how_far(folder, scene):
    previews = PreviewService(folder, default_registry(), SIZE)
    began = time.monotonic()
    first = previews.begin(scene)
    assert time.monotonic() - began < 0.5
    assert not first.geometry and first.left > 0
    for _ in range(600):
        if (now := previews.begin(scene)).geometry:
            break
        time.sleep(0.1)
    assert now.left == 0 and previews.sessions.is_located(scene)


@pytest.mark.parametrize("speaks", [False, True])
def test_the_photo_that_is_shown_is_read_first_and_others_while_nobody_speaks(
    folder, scene, monkeypatch, speaks
):
    read, spoke, done = [], Event(), Event()

    def located(*_):
        spoke.wait(60)
        read.append("geometry")

    previews = PreviewService(folder, default_registry(), SIZE)
    monkeypatch.setattr(
        previews.sessions, "_click", lambda opened, view: read.append(view)
    )
    monkeypatch.setattr(previews.sessions, "_geometry", located)
    monkeypatch.setattr(previews.sessions, "_keep", lambda *_: done.set())
    opened = previews.sessions.open(scene)
    if speaks:
        opened.asked.set()
    spoke.set()
    assert done.wait(60)
    assert read == [0, "geometry", *([] if speaks else [1])]
    previews.photo(scene, opened.views.names[1])  # a small one in the strip
    assert len(opened.read) == 2 - speaks
    previews.photo(scene, opened.views.names[1], shown=True)
    wait(opened.read.values())
    assert read == [0, "geometry", 1]


def test_geometry_survives_a_restart(previews, folder, scene):
    first = previews.sessions.open(scene)
    shown = first.geometry.result()
    for _ in range(100):
        if any((folder.beside(scene) / CACHE).glob("match-*")):
            break
        time.sleep(0.1)
    again = PreviewService(folder, default_registry(), SIZE)
    opened = again.sessions.open(scene)
    found = opened.geometry.result().geometry
    assert torch.equal(found.depths, shown.geometry.depths)
    assert "match" in opened.cache.reused
    assert "match" not in opened.cache.computed


def test_words_that_nobody_knows_are_a_question(previews, scene):
    look = previews.look(scene, Draft(words="the frobnicator"))
    assert any("frobnicator" in one for one in look.messages)
    assert not look.is_sure and look.masks is not None


@pytest.mark.parametrize("unsure", [None, 0, 1])
def test_of_two_named_things_either_may_be_a_question(
    previews, scene, monkeypatch, unsure
):
    mask = torch.ones(2, 1, 8, 8)
    things = tuple(
        Selected(mask, ("words",) * 2, confidence=0.1 if one == unsure else 1.0)
        for one in range(2)
    )
    found = SimpleNamespace(selection=SimpleNamespace(masks=None, selected=things))
    monkeypatch.setattr(preview_service, "preview", lambda *asked, **how: found)
    previews.selecting.forget()
    draft = Draft(form={"prompt": "make the sky warmer and the wall darker"})
    assert previews.look(scene, draft).is_sure == (unsure is None)


def test_a_candidate_is_shown_on_the_photo_where_it_was_found(previews, monkeypatch):
    images = torch.arange(2.0).view(1, 2, 1, 1, 1).expand(1, 2, 3, 8, 8)
    candidates = tuple(Candidate(one, torch.ones(8, 8), 0.5, one + 1) for one in (0, 1))
    views = Views(images, torch.eye(3).expand(1, 2, 3, 3))
    look = preview_service.DraftAnswer(views, candidates=candidates)
    monkeypatch.setattr(previews, "look", lambda *asked: look)
    dark, light = (
        np.median(Image.open(io.BytesIO(previews.candidate("any", Draft(), number))))
        for number in (1, 2)
    )
    assert dark < 100 < light


def test_what_cannot_be_read_waits_for_no_search(previews, scene):
    """And a search that nobody waits for any more is not begun."""
    answers = []

    def ask(prompt, **more):
        draft = Draft(form={"prompt": prompt})
        answers.append(previews.look(scene, draft, **more))

    previews.look(scene, Draft())
    with previews.selecting.working:  # another is being searched for
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


def test_who_points_waits_for_no_search(previews, scene):
    draft = Draft(form={"prompt": "make the sky warmer"})
    name = previews.look(scene, Draft()).views.names[0]
    edited = partial(previews.edited, scene, draft, name)
    with previews.selecting.working:  # somebody's words are searched for
        shown = Thread(target=edited, kwargs={"found": True})
        shown.start()
        shown.join(1)
        assert shown.is_alive()  # it waits for where the edit applies
        assert previews.pointing.working.acquire(timeout=1)
        previews.pointing.working.release()
    shown.join(60)
    named = Draft(form={"prompt": "paint the zeppelin red"})
    with previews.selecting.working:
        assert len(previews.edited(scene, named, name)) < 1000  # a clear pixel, at once


@pytest.mark.parametrize(
    ("sentence", "steps"),
    [
        ("make the background red", []),
        ("paint everything but this red", []),
        ("make it blue and the background red", []),
        ("paint all of it red", [Step("grow", 4)]),  # the outline is moved once
    ],
)
@pytest.mark.parametrize("found", [False, True])
def test_what_is_seen_before_go_is_what_go_makes(
    previews, scene, sentence, steps, found
):
    """Where the edit applies is no mark of the thing, of which "the background" is all else."""
    paint = stroke(previews, scene, "paint", 0.1, [(0.2, 0.2), (0.4, 0.2)])
    draft = Draft([paint, *steps], form={"prompt": sentence})
    look = previews.look(scene, draft)
    assert look.job is not None, look.problem
    whole = preview_service.preview(look.job, previews.registry).edit.views.images[0, 0]
    shown = previews.edited(scene, draft, look.views.names[0], found)
    image = torch.from_numpy(np.array(Image.open(io.BytesIO(shown)))) / 255
    image, before = image.permute(2, 0, 1), look.views.images[0, 0]
    assert (image - whole).abs().mean() < 0.06  # as JPEG
    if steps:  # a mean hides it
        changed = [(one - before).abs().amax(0) > 0.2 for one in (image, whole)]
        areas = [int(one.sum()) for one in changed]
        assert areas[0] == pytest.approx(areas[1], rel=0.15)


def test_the_edit_of_a_quick_editor_is_there_before_the_run(previews, folder, scene):
    paint = stroke(previews, scene, "paint", 0.2, [(0.3, 0.5), (0.7, 0.5)])
    draft = Draft([paint], form={"prompt": "paint all of it red"})
    look = previews.look(scene, draft)
    assert look.is_quick
    judged = previews.edit_verdict(look)  # before Go
    assert judged.label in ("good", "doubtful")
    previews._preview(look, "early")
    kept = manifest_of(folder.beside("early") / PREVIEW)["edit_verdict"]
    assert (kept["label"], kept["reason"]) == (judged.label, judged.reason)
    images = folder.images("early", PREVIEW)
    assert list(images) == list(look.views.names)
    edited = torch.tensor(list(Image.open(images[look.views.names[0]]).getdata()))
    red, green, _ = edited.float().mean(0)
    plain_red, plain_green, _ = look.views.images[0, 0].mean((1, 2)) * 255
    assert red - green > plain_red - plain_green + 10


def test_steps_change_what_is_selected_on_every_photo(previews, scene):
    mark = click(previews, scene)
    plain = previews.look(scene, Draft([mark]))
    areas = plain.masks.sum((1, 2))
    candidates = [Draft([mark, *[Step("larger", way)] * 9]) for way in (-1, 1)]
    smaller, larger = (
        previews.look(scene, one).masks.sum((1, 2)) for one in candidates
    )
    assert (smaller <= areas).all() and (areas <= larger).all()
    assert (smaller < larger).all()
    most = Draft([*candidates[1].marks, Step("larger", 1)])
    assert not previews.changes(scene, candidates[1], most)
    assert previews.changes(scene, *candidates)

    grown = previews.look(scene, Draft([mark, Step("grow", 3)]))
    assert (grown.masks.sum((1, 2)) > areas).all()
    assert torch.equal(grown.marked, plain.marked)  # the run moves the outline


def test_the_run_selects_what_is_shown(previews, scene):
    steps = [Step("grow", 3), Step("invert")]
    draft = Draft([click(previews, scene), *steps])
    shown = previews.look(scene, draft).masks
    draft.form["prompt"] = "paint it red"
    look = previews.look(scene, draft)
    assert look.problem == ""
    assert look.job.config.invert
    assert torch.allclose(look.masks, shown, atol=1e-6)


def test_words_tell_their_confidence_and_marks_have_none(previews, scene):
    form = {"prompt": "paint the motorcycle red"}
    named = previews.look(scene, Draft(words="sky"))
    assert 0 < named.confidence <= 1
    marked = previews.look(scene, Draft([click(previews, scene)], form=form))
    assert marked.confidence is None
    assert previews.edit_verdict(previews.look(scene, Draft())) is None


def test_fetched_weights_are_used_without_a_restart(previews, scene):
    draft = Draft([click(previews, scene)])
    before = previews.look(scene, draft)
    choice = RunConfig.model_fields["rasterizer"].default
    kept = previews.registry.build_choice("rasterizer", choice)
    assert previews.registry.build_choice("rasterizer", choice) is kept
    previews.renew()
    assert previews.look(scene, draft) is not before
    assert previews.registry.build_choice("rasterizer", choice) is not kept


def test_a_component_of_other_parts_is_another_one(folder):
    """A selector keeps its segmenter: one of another segmenter is not the one that was built."""
    registry = PreviewService(folder, default_registry(), SIZE).registry
    choice = RunConfig.model_fields["selector"].default
    first, second = (
        registry.build("segmenter", "grabcut", learned=learned)
        for learned in (True, False)
    )
    built = [
        registry.build_choice("selector", choice, {"segmenter": one})
        for one in (first, second, first)
    ]
    assert built[0] is built[2] is not built[1]
