"""The presets that ship, as they were measured."""

import pytest
from edit3r_measure.tradeoff.front import PRESETS, front

from edit3r.quality import preset_names, read_quality

from .settings_check import check_run_settings

QUALITY = read_quality()
KINDS = sorted({kind for point in QUALITY.points for kind in point.expected})


def test_there_are_three_measured_on_two_kinds_of_scene():
    assert preset_names(QUALITY) == list(PRESETS)
    assert len(KINDS) >= 2


@pytest.mark.parametrize("kind", KINDS)
def test_presets_are_on_the_front_of_everything_measured(kind):
    expected = [point.expected[kind] for point in QUALITY.points]
    flags = front([e.seconds for e in expected], [e.psnr for e in expected])
    assert all(flag for point, flag in zip(QUALITY.points, flags) if point.preset)


@pytest.mark.parametrize("kind", KINDS)
def test_presets_are_twice_apart_in_time(kind):
    seconds = {point.preset: point.expected[kind].seconds for point in QUALITY.points}
    assert 2 * seconds["fast"] <= seconds["balanced"] and 2 * seconds["balanced"] <= seconds["best"]


def test_every_shipped_point_can_be_run():
    for point in QUALITY.points:
        check_run_settings(point.settings)
