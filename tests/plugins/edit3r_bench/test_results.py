"""The page of results takes anybody's file and refuses a wrong one in a sentence."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from edit3r_bench.results import figures_of, read_method_results
from edit3r_bench.run import ItemResult

from edit3r import default_registry
from edit3r.contract.errors import SettingsError

ROOT = Path(__file__).parents[3]
STRANGER = """
method: lamp
link: https://lamp.example
about: switches a lamp on
hardware: RTX 4090
measured: 2026-12-01
rows:
  - {scene: rooms-1-add, verdict: good, cpu_seconds: 2, memory_mb: 900, gaussians: 1000,
     psnr: 61.5, ssim: 0.9, score: 0.7}
"""


def test_a_strangers_file_is_taken(tmp_path):
    (tmp_path / "lamp.yaml").write_text(STRANGER)
    lamp = read_method_results(tmp_path)["lamp"]
    assert lamp.rows[0].psnr == 61.5 and lamp.rows[0].lpips is None


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("https://lamp", "http://lamp", r"lamp.yaml.link"),
        ("psnr: 61.5", "psnr: 615", r"rows.*psnr"),
        ("psnr:", "psnrr:", r"psnrr"),
        ("verdict: good", "verdict: great", r"verdict"),
        ("hardware: RTX 4090", "hardware: ''", r"rows need `hardware`"),
        ("rows:", "missing: broken\nrows:", r"either `rows` or"),
    ],
)
def test_a_wrong_file_is_refused_in_a_sentence(old, new, sentence, tmp_path):
    (tmp_path / "lamp.yaml").write_text(STRANGER.replace(old, new))
    with pytest.raises(SettingsError, match=sentence) as refused:
        read_method_results(tmp_path)
    assert str(refused.value).count("\n") == 0


def test_every_reconstructor_has_figures_or_says_why_not():
    own = {folder.name for folder in (ROOT / "plugins").iterdir()}
    names = {
        offer.component.name
        for offer in default_registry().offers("reconstructor")
        if offer.module.partition(".")[0] in own
    }
    assert names <= set(read_method_results(ROOT / "docs/results"))


def test_the_edit_that_warms_up_and_failures_are_no_rows():
    timing = {"cold": False, "editor_cpu": 0.5, "scene_cpu": 1.5}
    facts = {"verdict": "fair", "peak_memory_mb": 700.4, "gaussians": 9}
    metrics = {"psnr": 30.0, "ssim": 0.9, "score": 0.5}
    result = ItemResult("rooms-1-add", "rooms-1", "Add", metrics, "", timing, facts)
    cold = ItemResult("cold", "rooms-1", "Add", metrics, "", timing | {"cold": True})
    failed = ItemResult("failed", "rooms-1", "Add", metrics, "no match")
    column = SimpleNamespace(results={one.id: one for one in (cold, result, failed)})
    (row,) = figures_of(column)
    assert (row.scene, row.cpu_seconds, row.memory_mb) == ("rooms-1-add", 2, 700)
