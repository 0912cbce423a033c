import pytest
import yaml

from edit3r.contract.errors import SettingsError
from edit3r.contract.reporting import Report, collecting
from edit3r.running import quality as presets
from edit3r.running.config import make_run_config
from edit3r.running.quality import PRESETS, note_quality, preset_point


def point(label, preset, **settings):
    figures = {
        "seconds": 1.0,
        "seconds_first": 2.0,
        "memory_mb": 400,
        "gaussians": 1000,
        "psnr": 20,
        "ssim": 0.5,
    }
    return {
        "label": label,
        "preset": preset,
        "settings": settings,
        "expected": {"photos": figures},
    }


@pytest.fixture(autouse=True)
def shipped(tmp_path, monkeypatch):
    """These points in place of those that ship."""
    one = {"name": "one", "planes": 24}
    points = [
        point("small", "fast", size=128, reconstructor=one),
        point("large", "best", size=512, reconstructor={"name": "one"}),
    ]
    path = tmp_path / "quality.yaml"
    path.write_text(yaml.safe_dump({"measured": {"clock": "cpu"}, "points": points}))
    monkeypatch.setattr(presets, "SHIPPED", path)
    return path


def test_a_preset_lies_under_what_the_user_says():
    config = make_run_config(
        {"quality": "fast"}, {"size": 300}, {"reconstructor": {"planes": 99}}
    )
    assert config.size == 300
    assert config.reconstructor.name == "one"
    assert config.reconstructor.settings == {"planes": 99}


def test_another_component_gets_none_of_the_presets_settings():
    config = make_run_config({"quality": "fast", "reconstructor": "two"})
    assert config.reconstructor.name == "two" and config.reconstructor.settings == {}
    assert config.size == 128


def test_a_preset_that_was_not_measured_is_an_error():
    with pytest.raises(
        SettingsError, match="--quality balanced: there is no measured preset"
    ):
        make_run_config({"quality": "balanced"})


def test_the_manifest_says_what_was_chosen_and_what_differs():
    report = Report()
    with collecting(report):
        note_quality(make_run_config({"quality": "fast", "size": 300}))
    noted = report.notes["quality"]
    assert (noted["preset"], noted["chosen"]) == ("fast", "small")
    assert noted["overridden"] == ["size"]
    assert noted["expected"]["photos"]["psnr"] == 20


def test_every_preset_ships(monkeypatch):
    monkeypatch.undo()
    assert all(preset_point(name)["settings"] for name in PRESETS)
