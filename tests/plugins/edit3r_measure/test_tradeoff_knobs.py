"""The knobs that a sweep turns, and the presets that ship, as they were measured."""

import pytest
import yaml
from edit3r_measure.tradeoff_knobs import make_points, read_plan
from edit3r_measure.tradeoff_points import front

from edit3r.config import make_settings
from edit3r.errors import SettingsError
from edit3r.pipeline.config import PART_KEYS, RunConfig, make_run_config
from edit3r.pipeline.quality import PRESETS, read_quality
from edit3r.plugins.registry import default_registry

QUALITY = read_quality()
KINDS = sorted({kind for point in QUALITY.points for kind in point.expected})
PLAN = {
    "base": {"size": 512, "reconstructor": {"name": "one", "planes": 64}},
    "unedited": {"editor": "none"},
    "edited": {"editor": "folder"},
    "knobs": {
        "size": {
            "about": "pixels",
            "values": {"128": {"size": 128}, "512": {"size": 512}},
        },
        "planes": {
            "about": "hypotheses",
            "values": {"few": {"reconstructor": {"planes": 24}}},
        },
    },
    "combinations": [{"size": 128, "planes": "few"}],
}


def check_run_settings(settings):
    """Raises SettingsError or UnknownComponentError for anything that is not known or out of
    range.
    """
    config, registry = make_run_config(settings), default_registry()
    for kind in PART_KEYS:
        choice = getattr(config, kind)
        if choice is None:
            continue
        offer = registry.find(kind, choice.name)
        made = make_settings(registry.settings_class(offer), choice.settings, kind)
        for part in offer.component.parts:
            inner = getattr(made, part)
            make_settings(
                registry.settings_class(registry.find(part, inner.name)),
                inner.settings,
                part,
            )


@pytest.fixture
def plan(tmp_path):
    def write(**changes):
        path = tmp_path / "knobs.yaml"
        path.write_text(
            yaml.safe_dump({**PLAN, **changes}, sort_keys=False), encoding="utf-8"
        )
        return read_plan(path)

    return write


def test_each_knob_alone_and_the_combinations_are_points_and_equal_ones_are_measured_once(
    plan,
):
    points = make_points(plan())
    assert list(points) == ["base", "size 128, planes few", "size 128", "planes few"]
    assert points["size 128, planes few"] == {
        "size": 128,
        "reconstructor": {"name": "one", "planes": 24},
    }


def test_named_knobs_alone_are_turned(plan):
    assert list(make_points(plan(), ["planes"])) == ["base", "planes few"]


def test_a_grid_is_every_combination(plan):
    labels = list(make_points(plan(), grid=True))
    assert labels == ["size 128, planes few", "size 512, planes few"]


@pytest.mark.parametrize(
    ("changes", "names", "said"),
    [
        (
            {},
            ["sizes"],
            "--knobs sizes: no such knob. Did you mean 'size'? Knobs: size, planes.",
        ),
        (
            {"combinations": [{"size": 1}]},
            None,
            "combinations: size=1 is not a knob's value; known here: 128, 512.",
        ),
        ({"sizes": 1}, None, "unknown setting"),
    ],
)
def test_a_wrong_knob_is_one_sentence(plan, changes, names, said):
    with pytest.raises(SettingsError) as error:
        make_points(plan(**changes), names)
    assert said in str(error.value)


def test_every_point_of_the_shipped_knobs_can_be_run():
    for settings in make_points(read_plan()).values():
        check_run_settings(settings)


def test_there_are_three_measured_on_two_kinds_of_scene():
    assert {point.preset for point in QUALITY.points} >= set(PRESETS)
    assert len(KINDS) >= 2


def test_presets_are_on_the_front_of_everything_measured():
    flags = front(
        [point.seconds for point in QUALITY.points],
        [point.accuracy for point in QUALITY.points],
    )
    assert all(flag for point, flag in zip(QUALITY.points, flags) if point.preset)


@pytest.mark.parametrize("kind", KINDS)
def test_presets_are_apart_in_time(kind):
    seconds = {point.preset: point.expected[kind].seconds for point in QUALITY.points}
    assert (
        1.5 * seconds["fast"] <= seconds["balanced"]
        and 1.5 * seconds["balanced"] <= seconds["best"]
    )


def test_the_best_preset_has_photos_of_full_size_and_the_default_was_measured():
    settings = {point.preset: point.settings for point in QUALITY.points}
    assert settings["best"]["size"] == RunConfig().size
    shared = {
        key: getattr(RunConfig(), key)
        for key in ("size", "refine", "grid", "gaussians")
    }
    assert any(
        {key: point.settings.get(key) for key in shared} == shared
        for point in QUALITY.points
    )


def test_every_shipped_point_can_be_run():
    for point in QUALITY.points:
        check_run_settings(point.settings)
