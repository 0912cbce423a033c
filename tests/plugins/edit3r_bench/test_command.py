"""`edit3r bench`: a small slice of the offline benchmark from end to end, and wrong use in one
sentence.
"""

import json

import pytest

from edit3r.cli.main import main


@pytest.mark.slow
def test_a_slice_of_the_offline_benchmark_runs_end_to_end(tmp_path, capsys):
    bench = f"{tmp_path}/bench.json"
    out = tmp_path / "out"
    assert (
        main(f"bench build --procedural 1 --size 64 --out {bench} --quiet".split()) == 0
    )
    run = (
        f"bench run {bench} --out {out} --config bench/offline --only edit3r --edits 2"
    )
    assert main(f"{run} --no-effnet".split()) == 0
    assert "[2/2] edit3r" in capsys.readouterr().err
    assert main(f"bench report {out}".split()) == 0
    assert "| score ↑ | 1 |" in capsys.readouterr().out
    report = json.loads((out / "report" / "report.json").read_text())
    assert report["methods"]["edit3r"]["metrics"]["score"]["mean"] > 0.2


def test_a_command_of_commands_lists_them(capsys):
    assert main(["bench"]) == 2
    shown = capsys.readouterr().out
    assert "build" in shown
    assert "report" in shown
    assert main(["bench", "runn"]) == 2
    assert "Did you mean 'run'?" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("run none.json --out x", "no such benchmark manifest"),
        ("run none.json --out x --workers 0", "bench run.workers"),
        ("run n.json --out x --config bench/offline --recon classical", "leave out"),
        ("run n.json --out x --config bench/offline --only best", "no such method"),
        ("build", "FOLDER"),
        ("report nowhere", "bench-run.json"),
    ],
)
def test_wrong_use_is_one_sentence(arguments, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["bench", *arguments.split()]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert words in error
    assert not list(tmp_path.iterdir())
