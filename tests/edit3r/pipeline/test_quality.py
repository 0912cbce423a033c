import pytest
import yaml

from edit3r.cli.main import main
from edit3r.errors import SettingsError
from edit3r.pipeline import quality as presets
from edit3r.pipeline.config import make_run_config
from edit3r.pipeline.quality import (
    Quality,
    Wish,
    choose,
    expectation,
    note_quality,
    read_quality,
    write_quality,
)
from edit3r.reporting import Report, collecting


def point(label, seconds, psnr, count, memory, preset=None, **settings):
    kinds = {
        kind: {
            "seconds": seconds * slower / 2,
            "seconds_first": seconds * slower,
            "memory_mb": memory,
            "start_memory_mb": 300,
            "gaussians": count,
            "psnr": psnr - better,
            "ssim": 0.5,
        }
        for kind, slower, better in (("photos", 1.0, 0), ("procedural", 1.25, 1))
    }
    return {"label": label, "preset": preset, "settings": settings, "expected": kinds}


QUALITY = {
    "measured": {"photos": 2, "clock": "cpu"},
    "points": [
        point(
            "small",
            1,
            20,
            1000,
            400,
            "fast",
            size=128,
            reconstructor={"name": "one", "planes": 24},
        ),
        point(
            "middle",
            2,
            22,
            4000,
            500,
            "balanced",
            size=256,
            reconstructor={"name": "one", "planes": 48},
        ),
        point("middle auto", 3, 21.9, 900, 510, size=256, gaussians="auto"),
        point(
            "large", 4, 23, 16000, 900, "best", size=512, reconstructor={"name": "one"}
        ),
    ],
}


@pytest.fixture
def shipped(tmp_path, monkeypatch):
    """These points in place of those that ship."""
    path = tmp_path / "quality.yaml"
    path.write_text(yaml.safe_dump(QUALITY), encoding="utf-8")
    monkeypatch.setattr(presets, "SHIPPED", path)
    return Quality(**QUALITY)


def chosen(points, photos=2, **wish):
    return choose(Wish(**wish), photos, points)[0].label


@pytest.mark.parametrize(
    ("preset", "label"), [("fast", "small"), ("balanced", "middle"), ("best", "large")]
)
def test_a_preset_is_its_point(shipped, preset, label):
    assert chosen(shipped, quality=preset) == label


@pytest.mark.parametrize(
    ("wish", "label"),
    [
        ({"budget_ms": 3000}, "middle"),  # 2 s on photos, 2.5 s on the other kind
        ({"budget_ms": 2499}, "small"),
        ({"budget_ms": 1e9}, "large"),
        ({"max_gaussians": 950}, "middle auto"),
        ({"max_memory": 450}, "small"),
        ({"quality": "best", "max_memory": 600}, "middle"),
        ({"quality": "fast", "budget_ms": 9000}, "small"),
        ({"budget_ms": 4000, "max_gaussians": 950, "max_memory": 510}, "middle auto"),
    ],
)
def test_a_budget_takes_the_most_accurate_point_that_fits(shipped, wish, label):
    assert chosen(shipped, **wish) == label


@pytest.mark.parametrize(
    ("wish", "said"),
    [
        (
            {"budget_ms": 1000},
            "--budget-ms 1000: too little for 2 photos; the least that was measured is 1250 ms.",
        ),
        (
            {"max_gaussians": 5},
            "--max-gaussians 5: too little for 2 photos; the least that was measured is 900 "
            "Gaussians; --gaussians 5",
        ),
        (
            {"max_memory": 100},
            "--max-memory 100: too little for 2 photos; the least that was measured is 400 MiB.",
        ),
        (
            {"max_gaussians": 950, "quality": "fast"},
            "--quality fast --max-gaussians 950: no measured setting fits all of these at once "
            "for 2 photos",
        ),
    ],
)
def test_an_impossible_wish_says_what_the_least_is(shipped, wish, said):
    with pytest.raises(SettingsError) as error:
        choose(Wish(**wish), 2, shipped)
    assert said in str(error.value) and error.value.exit_code == 2


def test_the_command_ends_an_impossible_wish_before_it_reads_a_photo(
    shipped, tmp_path, capsys
):
    assert main(["run", "--budget-ms", "1", "--out", str(tmp_path / "out")]) == 2
    assert "--budget-ms 1: too little for 2 photos" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_more_photos_are_expected_to_take_more(shipped):
    two, six = (expectation(shipped.points[0], scale) for scale in (1, 3))
    assert (
        six["seconds"] == 3 * two["seconds"]
        and six["gaussians"] == 3 * two["gaussians"]
    )
    assert six["memory_mb"] == 300 + 3 * (
        two["memory_mb"] - 300
    )  # the program itself does not grow
    assert six["psnr"] == two["psnr"]
    assert chosen(shipped, photos=4, budget_ms=3000) == "small"


def test_what_the_user_says_lies_over_the_preset(shipped):
    config = make_run_config(
        {"quality": "fast"}, {"size": 300}, {"reconstructor": {"planes": 99}}
    )
    assert config.size == 300
    assert config.reconstructor.name == "one" and config.reconstructor.settings == {
        "planes": 99
    }


def test_another_component_gets_none_of_the_presets_settings(shipped):
    config = make_run_config({"quality": "fast", "reconstructor": "two"})
    assert config.reconstructor.name == "two" and config.reconstructor.settings == {}
    assert config.size == 128


def test_the_limit_on_gaussians_stays_a_limit_of_the_run(shipped):
    config = make_run_config({"max_gaussians": 5000})
    assert config.size == 256 and config.max_gaussians == 5000


def test_photos_that_are_left_out_do_not_count(shipped):
    assert make_run_config({"budget_ms": 3000, "views": 2}, photos=10).size == 256


def test_no_wish_changes_nothing():
    assert make_run_config({"seed": 3}) == make_run_config({"seed": 3}, photos=99)


def test_the_manifest_tells_what_was_chosen_expected_and_overridden(shipped):
    config = make_run_config({"quality": "fast", "size": 300})
    with collecting(Report()) as report:
        note_quality(config.model_dump(), 2)
    told = report.notes["quality"]
    assert (
        told["wish"] == {"quality": "fast"}
        and told["chosen"] == "small"
        and told["preset"] == "fast"
    )
    assert told["overridden"] == ["size"]
    assert told["expected"]["seconds"] == 1.25 and told["expected"]["psnr"] == 19


def test_the_manifest_says_nothing_without_a_wish(shipped):
    with collecting(Report()) as report:
        note_quality(make_run_config({}).model_dump(), 2)
    assert report.notes == {}


def test_an_unmeasured_installation_says_so():
    with pytest.raises(SettingsError, match="nothing has been measured"):
        choose(Wish(quality="fast"), 2, Quality(measured={}, points=[]))


def test_a_wrong_wish_is_one_sentence(shipped):
    with pytest.raises(
        SettingsError,
        match=r"run\.quality: input should be 'fast', 'balanced' or 'best', got 'good'",
    ):
        make_run_config({"quality": "good"})


def test_the_file_survives_writing_and_reading(tmp_path, shipped):
    path = write_quality(shipped, tmp_path / "again.yaml")
    assert read_quality(path) == shipped
