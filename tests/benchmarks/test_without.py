"""The switch: a part is taken out, and its figure is made with and without it."""

import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "benchmarks"
SCRIPT = """
import json, sys
rows = [{"scene": "a", "value": value, "pair": f"{4 * value}, 2"} for value in (1, 2)]
json.dump({"rows": rows}, open(sys.argv[sys.argv.index("--json") + 1], "w"))
"""


@pytest.fixture
def without(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    for name in ("without", "harness"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    import without

    return without


def test_a_row_for_each_column_with_and_without_the_part(
    without, monkeypatch, tmp_path
):
    script = tmp_path / "figure.py"
    script.write_text(SCRIPT)
    made = []

    def figures(words, name=""):
        made.append((words, name))
        return {"value": 3.0 if name else 5.0}

    monkeypatch.setattr(without, "figures", figures)
    (row,) = without.main(["rim"], script="figure.py DATA")
    assert made == [(("figure.py", "DATA"), ""), (("figure.py", "DATA"), "rim")]
    assert row["with"][0] == 5 and row["without"][0] == 3 and row["brings"][0] == 2
    with pytest.raises(SystemExit, match="no such part"):
        next(without.main(["nothing"]))


def test_means_are_those_of_the_scripts_rows(without, tmp_path):
    script = tmp_path / "figure.py"
    script.write_text(SCRIPT)
    assert without.figures((str(script),)) == {
        "value": 1.5,
        "pair (1)": 6,
        "pair (2)": 2,
    }
    with pytest.raises(SystemExit, match="ended with"):
        without.figures((str(tmp_path / "none.py"),))


def test_settings_of_a_part_reach_every_run(without, monkeypatch):
    import edit3r

    monkeypatch.setattr(edit3r, "run", lambda *photos, **asked: asked)
    without.take_out("simplify")
    assert edit3r.run([], editor="none") == {"gaussians": "all", "editor": "none"}
    assert edit3r.run([], gaussians=3)["gaussians"] == 3


def test_a_place_is_replaced_and_one_that_is_gone_is_an_error(without, monkeypatch):
    import fractions

    monkeypatch.setattr(fractions, "gcd", None, raising=False)
    part = without.Part("", place="fractions:gcd", nothing=7)
    monkeypatch.setitem(without.PARTS, "gcd", part)
    without.take_out("gcd")
    assert fractions.gcd == 7
    gone = without.Part("", place="fractions:Fraction.gone")
    monkeypatch.setitem(without.PARTS, "gone", gone)
    with pytest.raises(AttributeError):
        without.take_out("gone")


def test_what_each_part_names_is_there(without):
    import functools
    import importlib

    from edit3r.running.config import make_run_config

    for part in without.PARTS.values():
        assert bool(part.settings) != bool(part.place)
        assert (FOLDER / part.figure.split()[0]).is_file()
        if part.place:
            module, _, path = part.place.partition(":")
            functools.reduce(getattr, path.split("."), importlib.import_module(module))
        else:
            asked = dict(part.settings)
            # a keyword of `edit3r.run` has another name, and one that it does not know is not used
            asked |= {"reconstructor": asked.pop("recon")} if "recon" in asked else {}
            assert "reconstructor" not in part.settings
            make_run_config(asked)
