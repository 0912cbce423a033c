"""The fit of the sum: it finds the cue that tells, and learns nothing from what was left out."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    monkeypatch.delitem(sys.modules, "ranking", raising=False)
    import ranking

    return ranking


def things_by(bench, scene, cue, count=40, never_fitted=False):
    """Things of a scene whose right mask is the one that has most of a cue."""
    random = np.random.default_rng(len(scene))
    found = []
    for number in range(count):
        cues = random.normal(size=(4, len(bench.NAMES)))
        ious = np.linspace(0.2, 0.9, 4)[
            cues[:, bench.NAMES.index(cue)].argsort().argsort()
        ]
        thing = bench.Thing(
            f"{scene}/{number}", scene, "own", False, Path(), [], never_fitted
        )
        thing.rows = [bench.Row(thing.name, "click", "anywhere", cues, ious)]
        found.append(thing)
    return found


def test_the_cue_that_tells_gets_the_weight(bench):
    things = things_by(bench, "a", "stability")
    values = bench.fitted_without(things, "click", None).values
    assert values.argmax() == bench.NAMES.index("stability")
    assert abs(np.delete(values, values.argmax())).max() < 0.4 * values.max()


@pytest.mark.parametrize("never_fitted", [False, True])
def test_a_scene_that_was_left_out_teaches_nothing(bench, never_fitted):
    out = None if never_fitted else "b"
    other = things_by(bench, "b", "border", never_fitted=never_fitted)
    things = things_by(bench, "a", "stability")
    both = bench.fitted_without(things + other, "click", out).values
    assert (both == bench.fitted_without(things, "click", None).values).all()


def test_figures_are_those_of_weights_that_did_not_see_the_scene(bench):
    things = things_by(bench, "a", "stability") + things_by(bench, "bb", "stability")
    told = bench.report(things, bench.folds(things, ("click",)))
    line = next(
        one for one in told.splitlines() if one.split()[:2] == ["anywhere", "all"]
    )
    assert "80 objects" in line and float(line.split()[5]) > 0.75


def test_photos_of_elsewhere_can_be_fetched_and_their_outlines_enclose_something(bench):
    content = json.loads((ROOT / "benchmarks/elsewhere.json").read_text())
    photos, objects = content["photos"], content["objects"]
    told = {"repository", "path", "commit", "licence"}
    assert all(set(one) == told and len(one["commit"]) == 40 for one in photos.values())
    shown = {file for one in objects.values() for file in one["photos"]}
    assert shown == set(photos)
    scenes = {name: name.split("/")[0] for name in objects}
    never = {scenes[name] for name, one in objects.items() if one.get("never_fitted")}
    assert len(objects) >= 60 and len(set(scenes.values())) >= 12
    assert len(never) >= len(set(scenes.values())) / 3
    for name, one in objects.items():
        assert one["word"] and one["how"] and isinstance(one["part"], bool)
        assert bool(one.get("never_fitted")) == (scenes[name] in never), name
        for rings in one["photos"].values():
            assert rings and all(len(ring) >= 3 for ring in rings), name
    hand = sum("by hand" in one["how"] for one in objects.values())
    assert hand >= len(objects) / 4
