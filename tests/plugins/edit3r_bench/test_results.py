"""The page of results takes anybody's file and refuses a wrong one in a sentence; it shows all."""

import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from edit3r_bench.results import figures_of, read_method_results
from edit3r_bench.run import ItemResult

from edit3r import default_registry
from edit3r.contract.errors import SettingsError

ROOT = Path(__file__).parents[3]
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
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


@pytest.mark.slow
@pytest.mark.skipif(
    CHROMIUM is None, reason="needs the program chromium: apt-get install chromium"
)
def test_a_strangers_row_stands_on_the_page_which_a_browser_sorts(tmp_path):
    playwright = pytest.importorskip("playwright.sync_api")
    ours = shutil.ignore_patterns("scenes", "__pycache__")
    shutil.copytree(ROOT / "docs", tmp_path / "docs", ignore=ours)
    shutil.copy(ROOT / "mkdocs.yml", tmp_path)
    (tmp_path / "benchmarks").symlink_to(ROOT / "benchmarks")
    (tmp_path / "plugins").symlink_to(ROOT / "plugins")
    (tmp_path / "docs/results/lamp.yaml").write_text(STRANGER)
    for command in (["docs/generate.py"], ["-m", "mkdocs", "build", "-q", "-s"]):
        subprocess.run([sys.executable, *command], cwd=tmp_path, check=True)
    with playwright.sync_playwright() as manager:
        browser = manager.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox"]
        )
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.goto((tmp_path / "site/results/index.html").as_uri())
        names = page.locator("tbody td:first-child")
        head = page.locator("th", has_text="psnr ↑").first
        count, places = names.count(), []
        for _ in range(2):
            head.click()
            places.append(names.all_inner_texts().index("lamp"))
        page.locator("th", has_text="lpips").click()
        without_figure = names.all_inner_texts()[-1]
        browser.close()
    # by PSNR it is the best, and of LPIPS it says nothing, which comes last either way
    assert places == [count - 1, 0] and without_figure == "lamp"
