"""The arguments, the table and the record of a benchmark."""

import json
import re
import sys
from collections.abc import Iterator, Sequence
from importlib.machinery import SourceFileLoader
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "benchmarks"
harness = SourceFileLoader("harness", str(FOLDER / "harness.py")).load_module()
SCRIPTS = [
    (file.stem, name.strip())
    for file in sorted(FOLDER.glob("*.py"))
    for names in re.findall(r"(?m)^    run_benchmark\((.*)\)$", file.read_text())
    for name in names.split(",")
]


def measures(
    folders: Sequence[Path],
    *,
    size: int = 8,
    only: Sequence[str] = (),
    plain: bool = False,
) -> Iterator[dict]:
    for folder in folders:
        yield {
            "folder": folder.name,
            "size": (size / 3, ".1f"),
            "asked": f"{list(only)} {plain}",
        }


def test_parameters_are_arguments_and_rows_a_table_and_a_record(tmp_path, capsys):
    record = tmp_path / "record.json"
    line = ["a", "b", "--size", "10", "--only", "x", "--json", str(record)]
    harness.run_benchmark(measures, line=line)
    assert capsys.readouterr().out.splitlines() == [
        "| folder | size | asked |",
        "| --- | --: | --- |",
        "| a | 3.3 | ['x'] False |",
        "| b | 3.3 | ['x'] False |",
    ]
    content = json.loads(record.read_text())
    assert content["arguments"]["size"] == 10
    assert content["arguments"]["by place"] == [["a", "b"]]
    assert content["rows"][0]["size"] == 10 / 3


def test_wrong_arguments_are_refused(capsys):
    with pytest.raises(SystemExit):
        harness.run_benchmark(measures, line=["a", "--size", "large"])
    assert "--size" in capsys.readouterr().err


def test_a_word_chooses_among_functions(monkeypatch, capsys):
    def itself():
        print(sys.argv[1:])

    monkeypatch.setattr(sys, "argv", ["bench.py"])
    with pytest.raises(SystemExit):
        harness.run_benchmark(measures, itself, line=["itself", "--more"])
    assert capsys.readouterr().out == "['--more']\n"
    harness.run_benchmark(measures, itself, line=["measures", "a"])
    assert "| a |" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        harness.run_benchmark(measures, itself, line=["neither"])
    assert "itself" in capsys.readouterr().err


@pytest.mark.parametrize(("script", "name"), SCRIPTS)
def test_a_script_says_what_it_measures(script, name, monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setitem(sys.modules, "harness", harness)
    monkeypatch.setattr(sys, "argv", [f"{script}.py"])
    path = str(FOLDER / f"{script}.py")
    module = SourceFileLoader(f"benchmark_{script}", path).load_module()
    with pytest.raises(SystemExit) as ended:
        harness.run_benchmark(getattr(module, name), line=["--help"])
    assert ended.value.code == 0
    shown = capsys.readouterr().out
    assert f"{script}.py" in shown and "--help" in shown
