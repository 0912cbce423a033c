"""The jobs file: what cannot run is refused with the number of its line, before anything is
written.
"""

import json

import numpy as np
import pytest
from edit3r_batch import jobs
from edit3r_batch.jobs import MAX_BYTES, read_jobs
from PIL import Image

from edit3r.cli.main import main
from edit3r.contract.errors import InputError
from edit3r.contract.reporting import Report, collecting
from edit3r.loading.registry import default_registry

GOOD = {"photos": ["a.png", "b.png"], "prompt": "paint it red"}


@pytest.fixture
def folder(tmp_path):
    for name in ("a.png", "b.png"):
        Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(tmp_path / name)
    return tmp_path


def read(folder, *lines, **defaults):
    texts = [line if isinstance(line, str) else json.dumps(line) for line in lines]
    (folder / "jobs.jsonl").write_text("\n".join(texts), encoding="utf-8")
    return read_jobs(folder / "jobs.jsonl", defaults, default_registry(), trusted=True)


def test_settings_are_those_of_a_configuration_file_over_the_defaults(folder):
    line = {**GOOD, "id": "bike", "editor": {"strength": 0.5}, "seed": 3}
    jobs = read(
        folder,
        line,
        "",
        {**GOOD, "photos": str(folder)},
        size=64,
        seed=1,
        editor="recolor",
    )
    assert list(jobs) == ["bike", "job-000003"]
    assert jobs["bike"].settings == {
        **{"prompt": "paint it red", "size": 64, "seed": 3},
        **_editor(0.5),
    }
    assert jobs["job-000003"].settings["seed"] == 1 and jobs["job-000003"].line == 3
    assert jobs["bike"].inputs.photos[0] == str(folder / "a.png")


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_file_of_jobs_is_read_as_windows_writes_it(folder, encoding):
    lines = [json.dumps({**GOOD, "id": name}) for name in ("ä", "b")]
    text = "\r\n".join([*lines, "", ""])
    (folder / "jobs.jsonl").write_bytes(text.encode(encoding))
    file = folder / "jobs.jsonl"
    assert [*read_jobs(file, {}, default_registry(), trusted=True)] == ["ä", "b"]


def _editor(strength):
    return {"editor": {"name": "recolor", "strength": strength}}


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("{", "not JSON"),
        ('{"photos": ["a.jpg"], "size": 96, "size": 128}', "'size' stands twice"),
        ("[" * 100_000, "not JSON"),
        ("[1]", "expected an object in braces, got list"),
        ({**GOOD, "promt": "x"}, "'promt' is no key of a job. Did you mean 'prompt'?"),
        ({"prompt": "x"}, "photos: field required"),
        ({**GOOD, "photos": []}, "photos"),
        ({**GOOD, "photos": ["a.png", "gone.png"]}, "gone.png: no such file"),
        ({**GOOD, "photos": "a" * 5000}, "File name too long"),
        ({**GOOD, "mask": "gone.png"}, "gone.png: no such file"),
        ({**GOOD, "cameras": "gone.json"}, "gone.json: no such file"),
        ({**GOOD, "size": 1}, "run.size"),
        ({**GOOD, "editor": "recolr"}, "Did you mean 'recolor'?"),
        ({**GOOD, "outputs": ["vewer"]}, "Did you mean 'viewer'?"),
        (
            {**GOOD, "editor": {"name": "recolor", "strenth": 1}},
            "editor.strenth: unknown setting",
        ),
        ({**GOOD, "id": "../x"}, "cannot be the name of a folder here; '__x' would do"),
        ({**GOOD, "id": "/tmp/x"}, "cannot be the name of a folder"),
        ({**GOOD, "id": ".."}, "cannot be the name of a folder"),
        ({**GOOD, "id": ".hidden"}, "cannot be the name of a folder"),
        ({**GOOD, "id": "x" * 300}, "cannot be the name of a folder"),
        ({**GOOD, "id": "summary.md"}, "cannot be the name of a folder"),
        ({**GOOD, "id": "First"}, "the id 'First' is that of line 1 too"),
        ({**GOOD, "prompt": "x" * MAX_BYTES}, "longer than 1,000,000 bytes"),
    ],
)
def test_a_job_that_cannot_run_is_refused_with_its_line(folder, line, sentence, capsys):
    with pytest.raises(InputError, match=r"jobs.jsonl, line 2: ") as error:
        read(folder, {**GOOD, "id": "first"}, line)
    assert sentence in str(error.value) and len(str(error.value)) < 3000
    assert (
        main(["batch", str(folder / "jobs.jsonl"), "--out", str(folder / "out")]) == 2
    )
    assert (
        len(capsys.readouterr().err.splitlines()) == 1 and not (folder / "out").exists()
    )


@pytest.mark.parametrize("content", [b"", b"\n \n", b"\xff\xfe\x00", None])
def test_a_file_without_jobs_is_refused(folder, content):
    if content is not None:
        (folder / "jobs.jsonl").write_bytes(content)
    with pytest.raises(InputError, match=r"jobs.jsonl"):
        read_jobs(folder / "jobs.jsonl", {}, default_registry(), trusted=True)


def test_secrets_are_in_no_record(folder):
    job = read(folder, {**GOOD, "editor": {"name": "recolor"}})["job-000001"]
    assert job.record == {
        "photos": ["a.png", "b.png"],
        "prompt": "paint it red",
        "editor": {"name": "recolor"},
    }


def test_many_lines_are_told_and_their_settings_checked_once(folder, monkeypatch):
    checks, told = [], []
    monkeypatch.setattr(jobs, "check_components", lambda *_: checks.append(1))
    monkeypatch.setattr(jobs, "TOLD_EVERY", 2)
    lines = [{**GOOD, "prompt": f"paint it {n}"} for n in range(5)]
    with collecting(Report(on_event=lambda *event: told.append(event))):
        read(folder, *lines)
    assert told == [("progress", "check jobs", done, 5) for done in (0, 2, 4)]
    assert len(checks) == 1
    for wrong in ({"prompt": "red " * 9999}, {"prompt": 3}, {"seed": "x"}):
        with pytest.raises(InputError, match="line 6"):
            read(folder, *lines, {**GOOD, **wrong})
