"""The table at the end of a batch."""

import json
import sys

import pytest
from edit3r_batch.command import _known_row, _print_progress, _table
from edit3r_batch.scenes import row_of

from edit3r.contract.errors import InputError, RunError
from edit3r.kit.workers import Progress, read_rows


def manifest(folder, edit_verdict):
    verdict = {"label": "good", "reason": "all fits", "input_psnr": [30.0, None, 20.0]}
    written = {
        "verdict": verdict,
        "edit_verdict": edit_verdict,
        "selection_verdict": {"label": "found", "confidence": 0.9},
        "gaussians": 5,
        "warnings": [],
    }
    (folder / "run.json").write_text(json.dumps(written))
    return {"id": "one", **row_of(folder)}


def test_the_table_shows_the_verdict_on_the_edit_and_why_it_is_doubtful(tmp_path):
    doubtful = {"label": "doubtful", "reason": "it lies in several pieces"}
    line = _table([manifest(tmp_path, doubtful)]).splitlines()[-1]
    assert line.startswith(
        "| one | found 90% | doubtful | good | edit: it lies in several pieces;"
    )


def test_a_run_without_an_edit_has_no_verdict_on_one(tmp_path):
    line = _table([manifest(tmp_path, None)]).splitlines()[-1]
    assert line == "| one | found 90% |  | good | all fits | 25.0 | 5 |"


@pytest.mark.parametrize(
    ("terminal", "done", "end"), [(True, 1, "left"), (True, 2, "\n"), (False, 1, "\n")]
)
def test_a_terminal_shows_one_line_that_changes_and_ends_it_after_the_last_job(
    capsys, monkeypatch, terminal, done, end
):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    row = {"verdict": "good", "psnr": 30.0}
    _print_progress(Progress("one", row, done, total=2, seconds_left=9.0))
    assert capsys.readouterr().err.endswith(end)


@pytest.mark.parametrize(
    "wrong",
    [
        {"verdict": "great"},
        {"verdict": None},
        {"edit": "great"},
        {"psnr": "high"},
        {"reason": None},
        {"gaussians": {}},
    ],
)
def test_a_row_of_something_else_is_named(tmp_path, wrong):
    row = manifest(tmp_path, None)
    failed = {"id": "two", "failure": "it was killed"}
    lines = [row, failed, {**row, "id": "three", **wrong}]
    file = tmp_path / "results.jsonl"
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(InputError, match="line 3: not a result"):
        read_rows(file, "id", _known_row)


@pytest.mark.parametrize(
    "verdict",
    [
        {"label": None},
        {"label": "great"},
        {"reason": None},
        {"input_psnr": [1e308, 1e308]},
        {"input_psnr": [float("nan")]},
    ],
)
def test_a_folder_whose_record_says_something_else_is_named(tmp_path, verdict):
    manifest(tmp_path, None)
    content = json.loads((tmp_path / "run.json").read_text())
    content["verdict"] |= verdict
    (tmp_path / "run.json").write_text(json.dumps(content))
    with pytest.raises(RunError, match=r"run\.json cannot be read"):
        row_of(tmp_path)
