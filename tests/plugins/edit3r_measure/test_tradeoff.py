"""What a sweep measures, takes up again and makes of it; and the presets that ship."""

import os
from itertools import pairwise

import pytest
import yaml
from edit3r_measure import tradeoff_measure, tradeoff_points
from edit3r_measure.scene_sources import EvaluationScene, SceneSource
from edit3r_measure.tradeoff import read_plan
from edit3r_measure.tradeoff_measure import (
    choose_presets,
    measure_points,
    measured_points,
    report,
    summarize,
)
from edit3r_measure.tradeoff_points import Expected, MeasuredPoint, Quality
from hypothesis import given, strategies as st

from edit3r.cli.main import main
from edit3r.contract.errors import InputError, SettingsError
from edit3r.kit.command.results import alone_in
from edit3r.kit.compute.lpips import lpips_weights
from edit3r.kit.files.configs import read_yaml
from edit3r.kit.workers import read_rows
from edit3r.loading.registry import default_registry
from edit3r.running.config import PART_KEYS, RunConfig, make_run_config
from edit3r.running.quality import PRESETS, SHIPPED as FILE

QUALITY = Quality.model_validate(read_yaml(FILE))
SHIPPED = QUALITY.points


def check_run_settings(settings):
    """Raise what an unknown component or a setting out of range raises."""
    config = make_run_config(settings)
    registry = default_registry()
    for kind in PART_KEYS:
        choice = getattr(config, kind)
        if choice is None:
            continue
        made = registry.check(kind, choice)
        for part in registry.find(kind, choice.name).component.parts:
            registry.check(part, getattr(made, part))


# ---- the plan ----


@pytest.fixture
def plan(tmp_path):
    one = {"name": "one", "planes": 64}
    content = {
        "base": {"size": 512, "reconstructor": one},
        "data": ["procedural"],
        "points": {"base": {}, "few": {"reconstructor": {"planes": 24}}},
    }
    path = tmp_path / "plan.yaml"
    path.write_text(yaml.safe_dump(content))
    return read_plan(str(path))


def test_a_point_is_the_base_with_its_own_settings_over_it(plan):
    points = plan.settings_of()
    assert list(points) == ["base", "few"]
    assert points["few"]["reconstructor"] == {"name": "one", "planes": 24}
    assert list(plan.settings_of(["few"])) == ["few"]


def test_a_point_that_is_not_in_the_plan_is_named(plan):
    with pytest.raises(SettingsError, match=r"--only few1: .*Did you mean 'few'"):
        plan.settings_of(["few1"])


def test_every_point_of_the_shipped_plan_can_be_run():
    for settings in read_plan().settings_of().values():
        check_run_settings(settings)


# ---- measuring ----


@pytest.fixture
def sources(folder):
    """One scene that nothing looks at."""
    photos = (folder.load(0, 8), folder.load(2, 8))
    files = ("0", "2", "1")
    scene = EvaluationScene("wall", "photos", files, photos, (folder.load(1, 8),))
    return [SceneSource("wall", lambda: scene)]


@pytest.fixture
def measured(monkeypatch):
    """The sizes that were measured, without a process for them."""
    sizes = []

    def pretend(job):
        sizes.append(job.settings["size"])
        return {"psnr": 20.0}

    monkeypatch.setattr(tradeoff_measure, "in_fresh_process", pretend)
    return sizes


def measure(sources, out, repeats=1, **points):
    settings = {label: {"size": size} for label, size in points.items()}
    return measure_points(settings, sources, out, repeats=repeats, threads=1)


def test_a_later_sweep_measures_what_is_missing_only(sources, tmp_path, measured):
    measure(sources, tmp_path, a=8)
    rows = measure(sources, tmp_path, other_name=8, b=9)
    assert measured == [8, 9]
    assert [row["label"] for row in rows] == ["other_name", "b"]
    measure(sources, tmp_path, repeats=2, a=8)
    assert measured == [8, 9, 8]


def test_a_line_that_a_kill_cut_short_is_measured_again(sources, tmp_path, measured):
    file = tmp_path / "measurements.jsonl"
    measure(sources, tmp_path, a=8, b=9)
    file.write_text(file.read_text()[:-20])
    measure(sources, tmp_path, a=8, b=9)
    assert measured == [8, 9, 9]
    assert len(read_rows(file)) == 2


PLAN = """
base: {reconstructor: classical, rasterizer: numba, size: 64, refine: 0, frames: 2}
data: [procedural]
size: 96
datasets: {procedural: {image_size: 96, context: 2, angles: [6, 10], seed: 4, textures: 8}}
points: {base: {}, wrong: {reconstructor: nobody}}
"""


def test_all_scenes_of_a_place_are_measured(tmp_path, monkeypatch):
    asked = []

    def measured(points, scenes, out, **effort):
        asked.extend(scenes)
        return []

    monkeypatch.setattr(tradeoff_measure, "measure_points", measured)
    (tmp_path / "plan.yaml").write_text(PLAN)
    command = f"tradeoff --plan {tmp_path}/plan.yaml --scenes 3 --out {tmp_path}/out"
    assert main(command.split()) != 0  # of nothing there are no presets
    assert len(asked) == 3


@pytest.mark.slow
def test_the_command_measures_runs_and_says_which_failed(
    tmp_path, capsys, forked_workers, monkeypatch
):
    monkeypatch.setattr(tradeoff_points, "SHIPPED", tmp_path / "never.yaml")
    (tmp_path / "plan.yaml").write_text(PLAN)
    out = tmp_path / "out"
    command = f"tradeoff --plan {tmp_path}/plan.yaml --scenes 1 --repeats 1 --threads 1"
    environment = dict(os.environ)
    assert main(f"{command} --out {out}".split()) == 0
    # the threads are the measured processes' alone
    assert dict(os.environ) == environment
    base, wrong = read_rows(out / "measurements.jsonl").values()
    assert wrong["failure"].startswith("no reconstructor named 'nobody'.")
    assert base["psnr"] > 15
    assert (base["lpips"] is None) == (lpips_weights() == "")
    assert base["gaussians"] > 100
    assert base["memory_mb"] > 50
    assert base["seconds_first"] > 0
    assert len(base["seconds"]) == 1
    table = (out / "tradeoff.md").read_text()
    assert "| procedural | base |" in table
    assert "wrong failed on procedural" in table
    # The same again resumes; one point is no choice.
    assert main(f"{command} --out {out} --update-presets".split()) == 2
    assert "the presets stay as they are" in capsys.readouterr().err
    with alone_in(out), pytest.raises(InputError, match="another run"), alone_in(out):
        pass


# ---- points and presets ----


def row(label="base", scene="s", **others):
    figures = {"memory_mb": 500.0, "gaussians": 100, "psnr": 20.0, "ssim": 0.5}
    figures |= {"lpips": None}
    times = {"seconds": [1.0, 2.0], "seconds_first": 9.0}
    about = {"label": label, "scene": scene, "kind": "photos", "settings": {"size": 8}}
    return {**about, **figures, **times, **others}


def test_a_point_has_the_quickest_repeats_and_means_over_the_scenes():
    rows = [row(psnr=18.0), row(scene="t", psnr=22.0, seconds=[5.0, 3.0])]
    (point,) = measured_points(rows)
    figures = point.expected["photos"]
    assert (figures.seconds, figures.seconds_first, figures.psnr) == (2.0, 9.0, 20.0)


def test_lpips_is_in_the_table_or_said_to_be_not_measured():
    def cells(*rows):
        *_, last = report(summarize(rows, {}), rows).rstrip().splitlines()
        return last.strip("| ").split(" | ")[-2:]

    about = {"day": "2026-11-28"}
    assert cells(row(**about)) == ["0.500", "not measured"]
    both = row(lpips=0.1, **about), row(scene="t", lpips=0.3, **about)
    assert cells(*both) == ["0.500", "0.200"]


def test_a_point_that_failed_or_lacks_a_scene_is_left_out():
    rows = [row("a"), row("a", scene="t"), row("b"), row("c")]
    rows.append(row("c", scene="t", failure="no match"))
    assert [point.label for point in measured_points(rows)] == ["a"]


def rated(name, seconds, psnr, other=None, size=8):
    """A point with the same figures on two kinds of scene, or with `other` (seconds, dB) on the
    second.
    """
    pairs = {"a": (seconds, psnr), "b": other or (seconds, psnr)}
    rest = dict.fromkeys(("seconds_first", "memory_mb", "gaussians", "ssim"), 1)
    expected = {
        kind: Expected(seconds=own[0], psnr=own[1], **rest)
        for kind, own in pairs.items()
    }
    return MeasuredPoint(label=name, settings={"size": size}, expected=expected)


def labels_of(points):
    return [point.label for point in choose_presets(points, apart=2).values()]


def test_presets_by_hand():
    points = [rated("a", 1, 10), rated("b", 1.5, 11), rated("c", 3.5, 14)]
    points += [rated("d", 6, 15), rated("e", 8, 16)]
    assert labels_of(points) == ["b", "c", "e"]


def test_lpips_decides_where_it_was_measured():
    """The dearest looks best, and PSNR prefers the blur."""
    points = [rated("a", 1, 22), rated("b", 2, 21), rated("c", 4, 20)]
    for point, distance in zip(points, (0.3, 0.2, 0.1)):
        for name, own in point.expected.items():
            point.expected[name] = own.model_copy(update={"lpips": distance})
    assert labels_of(points) == ["a", "b", "c"]


def test_presets_must_lie_apart():
    points = [rated("a", 1, 10), rated("b", 2, 12, other=(3, 12)), rated("c", 4, 14)]
    assert labels_of(points) == []
    assert labels_of([]) == []


def test_the_best_is_at_the_largest_size_although_a_smaller_one_scores_higher():
    points = [rated("a", 1, 10), rated("b", 2, 11), rated("d", 5, 13)]
    assert labels_of([*points, rated("c", 4, 12, size=9)]) == ["a", "b", "c"]


PAIRS = st.tuples(st.floats(0.1, 100), st.floats(0, 40))


@given(st.lists(st.tuples(PAIRS, PAIRS), max_size=10), st.floats(1.5, 3))
def test_presets_lie_apart_and_none_that_is_quicker_is_better(points, apart):
    points = [rated(str(i), *one, other=two) for i, (one, two) in enumerate(points)]
    chosen = choose_presets(points, apart)
    spent = lambda point: sum(one.seconds for one in point.expected.values())  # noqa: E731
    for name in chosen.keys() - {"best"}:
        quicker = [own for own in points if spent(own) < spent(chosen[name])]
        assert all(own.accuracy <= chosen[name].accuracy for own in quicker)
    for quick, slow in pairwise(map(spent, chosen.values())):
        assert apart * quick <= slow


# ---- the presets that ship ----


def test_three_presets_ship_as_they_follow_from_the_points():
    bare = [point.model_copy(update={"preset": None}) for point in SHIPPED]
    chosen = {name: point.label for name, point in choose_presets(bare).items()}
    assert chosen == {point.preset: point.label for point in SHIPPED if point.preset}
    assert set(chosen) == set(PRESETS)
    assert all(len(point.expected) == 2 for point in SHIPPED)


def test_the_best_preset_shows_what_large_photos_have_and_the_default_was_measured():
    settings = {point.preset: point.settings for point in SHIPPED}
    assert settings["best"]["size"] > RunConfig().size > settings["balanced"]["size"]
    keys = ("size", "refine", "grid", "gaussians")
    default = [getattr(RunConfig(), key) for key in keys]
    assert default in [[point.settings.get(key) for key in keys] for point in SHIPPED]


def test_what_is_written_is_read_again(tmp_path, monkeypatch):
    monkeypatch.setattr(tradeoff_points, "SHIPPED", tmp_path / "again.yaml")
    assert Quality.model_validate(read_yaml(QUALITY.write())) == QUALITY


def test_every_shipped_point_can_be_run():
    for point in SHIPPED:
        check_run_settings(point.settings)


def test_a_number_too_small_is_one_sentence(capsys):
    assert main(["tradeoff", "--repeats", "0"]) == 2
    assert "tradeoff.repeats" in capsys.readouterr().err
