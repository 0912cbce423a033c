"""What the page asks for: plain data in and out, and every press that is impossible said."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from edit3r_app import uploads
from edit3r_app.draft import read_draft
from edit3r_app.drawing import Drawing
from edit3r_app.jobs import AppJob, JobsFolder
from edit3r_app.preview_service import PreviewService
from edit3r_app.runner import Runner
from edit3r_app.studio import PREVIEW, Studio, _in_own_frame, verdicts
from PIL import Image

from edit3r.contract.errors import InputError
from edit3r.kit.photos.images import packaged_pair
from edit3r.loading.registry import default_registry

CLICK = {"kind": "add", "photo": "motorcycle", "places": [[0.5, 0.5]]}


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    folder = JobsFolder(tmp_path_factory.mktemp("jobs"))
    yield Studio(
        folder,
        Runner(folder),
        PreviewService(folder, default_registry(), 64),
        Drawing(folder, default_registry()),
    )


@pytest.fixture
def scene(studio):
    return uploads.copied(
        studio.folder, "motorcycle", [Path(one) for one in packaged_pair()[0]]
    )


def test_a_scene_is_plain_data(studio, scene):
    told = studio.scene(scene, "")
    assert json.loads(json.dumps(told)) == told
    assert (told["state"], told["isRun"], told["fixed"]) == (scene, False, False)
    assert len(told["photos"]) == 2 and told["draft"]["selects"] is False
    job = studio.folder.new_job(AppJob("", scene, settings={"prompt": "gold"}))
    waits = studio.scene(scene, job.name)
    assert (waits["job"]["state"], waits["job"]["prompt"]) == ("queued", "gold")
    assert waits["fixed"] and waits["photos"] == told["photos"]
    assert [one["prompt"] for one in waits["history"]] == ["gold"]


def test_a_state_of_another_scene_is_refused(studio, scene):
    other = studio.folder.new_scene("other")
    job = studio.folder.new_job(AppJob("", other))
    with pytest.raises(InputError, match="not an edit of"):
        studio.scene(scene, job.name)


def test_a_card_opens_where_it_was_left_else_at_the_newest_edit_that_worked(
    studio, scene
):
    def opens():
        return next(one["at"] for one in studio.scenes() if one["name"] == scene)

    first, second, failed = (
        studio.folder.new_job(AppJob("", scene, settings={"prompt": word}))
        for word in ("gold", "blue", "red")
    )
    assert opens() == ""
    for job in (first, second):
        (studio.folder.root / job.name).mkdir()
        (studio.folder.root / job.name / "run.json").write_text("{}")
    studio.folder.write(replace(failed, state="failed"))
    assert opens() == second.name
    studio.scene(scene, "")
    assert opens() == ""


def test_a_draft_is_changed_undone_and_redone(studio, scene):
    first = studio.change(scene, {"do": "mark", "value": CLICK})
    assert first["selects"]
    assert not studio.change(scene, {"do": "undo"})["selects"]
    assert studio.change(scene, {"do": "redo"})["version"] == first["version"]
    studio.change(scene, {"do": "say", "value": "paint it red"})
    studio.change(scene, {"do": "set", "value": ["run", "seed", "7"]})
    studio.change(scene, {"do": "set", "value": ["", "editor", "recolor"]})
    form = read_draft(studio.folder, scene).form
    assert form == {
        "prompt": "paint it red",
        "editor": "recolor",
        "settings": {"run": {"seed": "7"}},
    }
    assert not studio.change(scene, {"do": "select", "value": ""})["selects"]


def test_selections_kept_by_name_are_there_for_every_edit_of_the_photos(studio, scene):
    studio.change(scene, {"do": "mark", "value": CLICK})
    assert studio.change(scene, {"do": "keep", "value": "door"})["named"] == ["door"]
    run = studio.folder.new_job(AppJob("", scene)).name
    (studio.folder.root / run).mkdir()
    (studio.folder.root / run / "run.json").write_text("{}")
    assert studio.change(run, {"do": "recall", "value": "door"})["selects"]
    studio.change(run, {"do": "keep", "value": "it"})
    told = studio.change(scene, {"do": "drop", "value": "door"})
    assert told["named"] == ["it"] and told["selects"]


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ({}, "no such change"),
        ({"do": "burn"}, "no such change"),
        ({"do": "mark", "value": {**CLICK, "places": [[2, 0]]}}, "not a change"),
        ({"do": "mark", "value": None}, "not a change"),
        ({"do": "step", "value": ["larger"]}, "not a change"),
        ({"do": "set", "value": "x"}, "not a change"),
        ({"do": "recall", "value": "nothing"}, "not a change"),
        ({"do": "drop", "value": "nothing"}, "not a change"),
        ({"do": "keep", "value": "door"}, "point at something first"),
    ],
)
def test_what_is_no_change_is_refused_and_changes_nothing(studio, scene, asked, told):
    before = read_draft(studio.folder, scene)
    with pytest.raises(InputError, match=told):
        studio.change(scene, asked)
    assert read_draft(studio.folder, scene) == before


def test_a_thing_is_taken_of_a_scene_only_and_its_edit_is_a_state_of_its_own(
    studio, scene
):
    with pytest.raises(InputError, match="no scene yet"):
        studio.act(scene, "", {"action": "find"})
    run = studio.folder.new_job(AppJob("", scene)).name
    renders = studio.folder.root / run / "renders"
    renders.mkdir(parents=True)
    Image.new("RGB", (8, 6)).save(renders / "left.png")
    (renders.parent / "run.json").write_text('{"objects": {"bike": 0}}')
    name = studio.act(scene, run, {"action": "remove", "name": "bike"})
    job = studio.folder.job(name)
    assert (job.parent, job.object.call) == (run, ("remove", "bike"))
    assert job.prompt == "remove bike"
    told = studio.scene(scene, run)  # without photos, it is shown by what was rendered
    assert told["byHand"] and told["photos"] == ["left"]
    assert told["objects"] == ["bike"]
    assert told["reading"]["geometry"] and told["reading"]["placed"]


def test_no_edit_without_a_sentence(studio, scene):
    with pytest.raises(InputError, match="such as: paint it golden"):
        studio.go(scene, "", "")


def test_a_stroke_over_a_scene_that_was_given_comes_into_the_frame_of_its_file():
    """View 0 looks along x from (5, 6, 7), and its unit is half as long."""
    c2w = torch.tensor([[0.0, 0, 1, 5], [0, 1, 0, 6], [-1, 0, 0, 7], [0, 0, 0, 1]])
    given = SimpleNamespace(views=SimpleNamespace(c2w=c2w, unit=2.0))
    stroke = {"right": [1, 0, 0], "down": [0, 1, 0], "forward": [0, 0, 1]}
    moved = _in_own_frame({**stroke, "centre": [1, 2, 3], "size": 4}, given)
    assert moved == {
        "right": [0, 0, -1],
        "down": [0, 1, 0],
        "forward": [1, 0, 0],
        "centre": [3 * 2 + 5, 2 * 2 + 6, -1 * 2 + 7],
        "size": 4,
    }
    for wrong in (None, stroke, {**stroke, "centre": "x"}):
        assert _in_own_frame(wrong, given) is wrong


def test_a_run_has_its_own_answers_and_one_that_is_made_those_of_its_preview(tmp_path):
    folder = JobsFolder(tmp_path)
    beside, run = folder.private / "jar" / PREVIEW, tmp_path / "jar"
    answers = {"verdict": {"label": "good", "reason": "r" * 2000}}
    edited = {"selection_verdict": {"label": "found"}, "edit_verdict": None}
    for place, manifest in (
        (beside, {"verdict": {"label": "x"}}),
        (run, answers | edited),
    ):
        place.mkdir(parents=True)
        assert [one["on"] for one in verdicts(folder, "jar")] == ["scene"] * (
            place == run
        )
        (place / "run.json").write_text(json.dumps(manifest))
    selected, scene = verdicts(folder, "jar")
    assert selected == {"on": "selected", "label": "found", "reason": ""}
    assert (scene["on"], scene["label"], scene["reason"]) == (
        "scene",
        "good",
        "r" * 1000,
    )


def test_a_scene_goes_with_its_edits_and_another_stays(studio, scene):
    other = studio.folder.new_scene("other")
    run = studio.folder.new_job(AppJob("", scene)).name
    (studio.folder.root / run).mkdir()
    (studio.folder.root / run / "run.json").write_text("{}")
    studio.delete(scene)
    left = studio.folder.scenes()
    assert other in left and not {scene, run} & set(left)
    with pytest.raises(InputError, match="no scene of that name"):
        studio.delete(scene)
