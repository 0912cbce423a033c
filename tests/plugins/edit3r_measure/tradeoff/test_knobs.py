import pytest
import yaml
from edit3r_measure.tradeoff.knobs import make_points, read_plan

from edit3r.errors import SettingsError

from .settings_check import check_run_settings

PLAN = {
    "base": {"size": 512, "reconstructor": {"name": "one", "planes": 64}},
    "unedited": {"editor": "none"},
    "edited": {"editor": "folder"},
    "knobs": {
        "size": {"about": "pixels", "values": {128: {"size": 128}, 512: {"size": 512}}},
        "planes": {"about": "hypotheses", "values": {"few": {"reconstructor": {"planes": 24}}}},
    },
    "combinations": [{"size": 128, "planes": "few"}],
}


@pytest.fixture
def plan(tmp_path):
    def write(**changes):
        path = tmp_path / "knobs.yaml"
        path.write_text(yaml.safe_dump({**PLAN, **changes}, sort_keys=False), encoding="utf-8")
        return read_plan(path)

    return write


def test_each_knob_alone_and_the_combinations_are_points_and_equal_ones_are_measured_once(plan):
    points = make_points(plan())
    assert [p.label for p in points] == ["base", "size 128, planes few", "size 128", "planes few"]
    assert points[1].settings == {"size": 128, "reconstructor": {"name": "one", "planes": 24}}


def test_named_knobs_alone_are_turned(plan):
    assert [p.label for p in make_points(plan(), ["planes"])] == ["base", "planes few"]


def test_a_grid_is_every_combination(plan):
    labels = [p.label for p in make_points(plan(), grid=True)]
    assert labels == ["size 128, planes few", "size 512, planes few"]


@pytest.mark.parametrize(
    ("changes", "names", "said"),
    [
        ({}, ["sizes"], "--knobs sizes: no such knob. Did you mean 'size'? Knobs: size, planes."),
        ({"combinations": [{"size": 1}]}, None, "combinations: size=1 is not a knob's value; known here: 128, 512."),
        ({"sizes": 1}, None, "unknown setting"),
    ],
)
def test_a_wrong_knob_is_one_sentence(plan, changes, names, said):
    with pytest.raises(SettingsError) as error:
        make_points(plan(**changes), names)
    assert said in str(error.value)


def test_every_point_of_the_shipped_knobs_can_be_run():
    for point in make_points(read_plan()):
        check_run_settings(point.settings)
