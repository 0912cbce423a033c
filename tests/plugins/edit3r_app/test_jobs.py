"""The jobs folder: names are never paths, folders of the command line are listed, history is a
tree.
"""

import json
from dataclasses import replace

import pytest
from edit3r_app.jobs import AppJob, JobsFolder, manifest_of, tree
from PIL import Image

from edit3r.contract.errors import InputError

DAMAGED = '{"name": "bear-1", "scene": "bear", "state": "running", "masks": "x"}'


@pytest.fixture
def folder(tmp_path):
    return JobsFolder(tmp_path / "jobs")


def make_run(folder, name, **manifest):
    for kind in ("inputs", "edited", "renders"):
        (folder.root / name / kind).mkdir(parents=True)
        for view in ("a", "b"):
            Image.new("RGB", (8, 6), "grey").save(
                folder.root / name / kind / f"{view}.png"
            )
    (folder.root / name / "run.json").write_text(json.dumps(manifest))


@pytest.mark.parametrize(
    "name",
    [
        "..",
        ".",
        "",
        "../jobs",
        "a/b",
        "a\\b",
        "/etc",
        ".edit3r-app",
        "x\0",
        "nothing",
        None,
    ],
)
def test_names_that_are_no_folder_of_ours_are_refused(folder, name):
    with pytest.raises(InputError, match="no photos and no run"):
        folder.path(name)
    with pytest.raises(InputError, match="no run of that name"):
        folder.job(name)


def test_nothing_is_written_through_a_link(folder, tmp_path):
    (folder.private / "bear").symlink_to(tmp_path)
    with pytest.raises(InputError, match="leads out of the jobs folder"):
        folder.beside("bear")
    other = tmp_path / "other"
    other.mkdir()
    (other / ".edit3r-app").symlink_to(tmp_path)
    with pytest.raises(InputError, match="leads out of the jobs folder"):
        JobsFolder(other)


@pytest.mark.parametrize(
    "instruction", ["../../etc/passwd", "", "..", "CON", "a" * 500, "<b>x</b>", "bear"]
)
def test_new_sets_lie_directly_in_the_jobs_folder(folder, instruction):
    first, second = folder.new_scene(instruction), folder.new_scene(instruction)
    assert first.casefold() != second.casefold()
    for name in (first, second):
        assert folder.path(name).parent == folder.root and folder.photos(name) == {}


def test_photos_dropped_while_an_edit_waits_do_not_take_its_name(folder):
    job = folder.new_job(AppJob("", folder.new_scene("bear")))
    assert folder.new_scene(job.name) != job.name
    assert not (folder.root / job.name).exists()


def test_a_run_of_the_command_line_is_listed_with_its_instruction_and_verdict(folder):
    make_run(
        folder,
        "mine",
        prompt="paint it red",
        verdict={"label": "fair", "reason": "so so"},
    )
    job = folder.job("mine")
    assert (job.scene, job.state, job.prompt) == ("mine", "done", "paint it red")
    assert manifest_of(folder.root / "mine")["verdict"]["label"] == "fair"
    assert folder.scenes() == ["mine"]
    assert list(folder.photos("mine")) == ["a", "b"]


@pytest.mark.parametrize(
    "content",
    ["", "[]", "{", '{"verdict": 3, "prompt": null}', "[" * 100_000, "\x00\xff"],
)
def test_a_damaged_run_json_breaks_no_listing(folder, content):
    make_run(folder, "mine")
    (folder.root / "mine" / "run.json").write_text(content, encoding="latin-1")
    assert folder.job("mine").state == "done"
    assert isinstance(manifest_of(folder.root / "mine"), dict)


@pytest.mark.parametrize(
    "content",
    [
        "",
        "[]",
        '{"name": 5}',
        '{"name": "../../x", "scene": "y", "state": "odd"}',
        DAMAGED,
    ],
)
def test_a_damaged_record_is_passed_over(folder, content):
    (folder.private / "bear-1.json").write_text(content)
    assert list(folder.jobs()) == []


def test_what_is_written_is_read_by_another_server(folder):
    scene = folder.new_scene("bear")
    job = folder.new_job(
        AppJob("", scene, settings={"prompt": "gold"}, masks=2, size=128)
    )
    assert job.name == "bear-1"
    assert JobsFolder(folder.root).job("bear-1") == job
    assert folder.new_job(AppJob("", scene)).name == "bear-2"


def test_a_job_that_says_done_but_left_no_run_has_failed(folder):
    job = folder.new_job(AppJob("", folder.new_scene("bear"), state="done"))
    assert folder.job(job.name).state == "failed"


def history():
    def job(name, parent, state="done"):
        return AppJob(name, "bear", parent, state=state)

    return [
        job("bear-1", ""),
        job("bear-2", "bear-1"),
        job("bear-3", "bear-1"),
        job("bear-4", ""),
        job("bear-5", "", "failed"),
    ]


def test_branches_stand_below_what_they_go_on_from():
    depths = [(depth, job.name) for depth, job in tree(history())]
    assert depths == [
        (0, "bear-1"),
        (1, "bear-2"),
        (1, "bear-3"),
        (0, "bear-4"),
        (0, "bear-5"),
    ]


def test_the_history_of_a_run_of_the_command_line_begins_with_itself(folder):
    make_run(folder, "mine")
    job = folder.new_job(AppJob("", "mine", "mine"))
    jobs = folder.history("mine")
    assert sorted(one.name for one in jobs) == ["mine", job.name]
    assert [(depth, one.name) for depth, one in tree(jobs)] == [
        (0, "mine"),
        (1, job.name),
    ]


def test_a_deleted_scene_is_whole_in_a_folder_of_its_own(folder):
    folder.new_scene("bear")
    (folder.root / "bear" / "images" / "a.png").write_bytes(b"a photo")
    job = folder.new_job(AppJob("", "bear", settings={"prompt": "gold"}))
    with pytest.raises(InputError, match="cancel it first"):
        folder.delete("bear")
    make_run(folder, job.name, prompt="gold")
    folder.write(replace(job, state="done"))
    left = folder.new_scene("other")
    folder.delete("bear")
    assert folder.scenes() == [left] and not folder.history("bear")
    for name in ("bear", job.name, f".edit3r-app/{job.name}.json"):
        assert not (folder.root / name).exists()
    deleted = JobsFolder(folder.root / ".deleted")
    assert deleted.scenes() == ["bear"]
    assert [one.prompt for one in deleted.history("bear")] == ["gold"]
    # nothing new takes a name that is there
    assert folder.new_scene("bear") != "bear"
    assert folder.new_job(AppJob("", "bear")).name != job.name


def test_a_jobs_folder_that_cannot_be_made_is_said(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="cannot be the jobs folder"):
        JobsFolder(tmp_path / "file")
