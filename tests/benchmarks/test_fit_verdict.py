"""Limits lie between good and bad; a place is judged without itself."""

import json
from importlib.machinery import SourceFileLoader
from pathlib import Path

import pytest
from edit3r_judge.signals import FITTED, SIGNALS

from edit3r.contract.errors import InputError
from edit3r.kit.files.configs import read_yaml

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def fit(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    path = str(BENCHMARKS / "fit_verdict.py")
    return SourceFileLoader("fit_verdict_script", path).load_module()


@pytest.fixture
def shown(fit, tmp_path):
    """The table that is made of rows, by outcome."""

    def table(rows):
        path = tmp_path / "rows.jsonl"
        path.write_text("\n".join(map(json.dumps, rows)))
        return {name.strip(): rest for name, *rest in map(dict.values, fit.main(path))}

    return table


CLEAN = {name: 1.0 if one.at_least else 0.0 for name, one in SIGNALS.items()}


def rows(places: int = 4) -> list[dict]:
    """A good edit and one with each fault at each place."""
    found = []
    for place in range(places):
        about = {"place": f"p{place}"}
        found.append(about | {"kind": "well", "fault": None, "figures": CLEAN})
        for name in SIGNALS:
            figures = CLEAN | {name: 0.5}
            found.append(about | {"kind": name, "fault": name, "figures": figures})
    return found


def test_limits_lie_midway_between_good_and_bad_edits(fit):
    limits = fit.limits_of_edits(rows())
    assert limits == {n: pytest.approx(0.25 + 0.5 * (CLEAN[n] == 1)) for n in SIGNALS}


def test_good_and_bad_count_alike_however_many_there_are(fit):
    good, bad = [0.1, 0.2, 0.6], [0.5, 0.7, 0.8]
    assert fit.between(good, bad) == fit.between(3 * good, bad) == pytest.approx(0.35)
    assert fit.between([0.1, 0.6], [0.3, 0.4, 0.7, 0.8]) == pytest.approx(0.2)
    assert fit.between([0.1, 0.6], [0.3, 0.4, 0.7, 0.8], 2) == pytest.approx(0.65)


def test_the_table_says_what_is_named_where_nothing_was_fitted(shown):
    found = shown(rows())
    assert found["called good"][1] == "2 of 2 (100.0%)"  # of p0 and p3
    assert all(
        found[f"{name} called {name}"][1] == "2 of 2 (100.0%)" for name in SIGNALS
    )


@pytest.mark.parametrize("text", ["{", '{"place": "a"}', "3"])
def test_rows_of_something_else_are_refused(fit, tmp_path, text):
    path = tmp_path / "rows.jsonl"
    path.write_text(text)
    with pytest.raises(InputError, match=r"rows\.jsonl: .*verdict\.py"):
        fit.read_rows(path)


SCENES = [
    {"place": place, "label": label, "figures": {"half_way": part}}
    for place in ("a", "b", "c", "d")
    for label, part in (("good", 0.1), ("fair", 0.3), ("poor", 0.6))
]


def test_the_limit_of_a_label_lies_between_scenes_that_deserve_it_and_others(fit):
    limits = fit.limits_of_scenes(SCENES)
    assert limits["good"] == {"half_way": pytest.approx(0.2)}
    assert limits["fair"] == {"half_way": pytest.approx(0.45)}


def test_scenes_are_told_without_their_place_and_by_all(shown):
    found = shown([*SCENES, SCENES[5] | {"figures": {"half_way": 0.1}}])
    assert found["good or fair or not"][0] == "6 of 7 (85.7%)"
    assert found["called good or fair"][0] == "4 of 5 (80.0%)"
    assert found["good or not"][1] == "6 of 6 (100.0%)"


def test_limits_are_written_beside_those_of_scenes(fit, tmp_path, monkeypatch):
    own = tmp_path / "limits.yaml"
    own.write_text(FITTED.read_text())
    monkeypatch.setattr("edit3r_judge.signals.FITTED", own)
    fit.write_limits({"edit": dict.fromkeys(SIGNALS, 0.123)})
    was, now = (read_yaml(path) for path in (FITTED, own))
    assert now["edit"] == dict.fromkeys(SIGNALS, 0.123)
    assert now["scene"] == was["scene"] and own.read_text().startswith("#")
    fit.write_limits({"scene": {"fair": {"half_way": 0.25}}})
    again = read_yaml(own)
    assert again["scene"].pop("fair") == was["scene"].pop("fair") | {"half_way": 0.25}
    assert again["scene"] == was["scene"] and again["edit"] == now["edit"]


def parts(place: str) -> list[dict]:
    """A sound part, and broken ones of each kind at each strength."""
    sound = {"geometry": 1.0, "reference": 0.0, "flat": 0.5, "half_way": 0.1}
    found = [{"kind": "sound", "strength": 0, "figures": sound}]
    for strength in (1, 2, 3):
        off = sound | {"geometry": 1 + strength}
        found.append({"kind": "plane", "strength": strength, "figures": off})
        blurred = sound | {"reference": 0.1 * strength}
        found.append({"kind": "torn", "strength": strength, "figures": blurred})
    return [{"place": place, **row} for row in found]


def test_limits_of_parts_lie_between_sound_ones_and_what_must_be_told(fit):
    limits = fit.limits_of_parts(parts("a"))
    # nine of ten of 3 and 4 reach 2.3, of .2 and .3 reach .13
    wanted = {"geometry": 1.65, "reference": 0.065, "flat": 0.825}
    assert limits == pytest.approx(wanted)


def test_a_broken_part_is_told_by_the_signal_of_its_kind(fit, shown):
    found = shown([row for place in "abcd" for row in parts(place)])
    assert found["broken ones told"][0] == "8 of 8 (100.0%)"
    assert found["sound ones not blamed"][0] == "2 of 2 (100.0%)"
    without = {"geometry": 9, "reference": 0.15, "flat": 1}
    told = dict(fit.outcomes_of_parts(parts("a")[3], without))
    assert told["broken ones told"] is False  # each signal tells what no other does
