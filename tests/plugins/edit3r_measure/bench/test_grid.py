"""The grid: every editor with every reconstructor, and a row with its sentence for each pair that
gives nothing.
"""

import pytest
from edit3r_measure.bench_grid import pairs_of
from edit3r_measure.oracle import ORACLE

from edit3r.cli.main import main
from edit3r.errors import SettingsError
from edit3r.plugins.registry import default_registry


def test_every_pair_is_a_row_and_failures_say_why(
    manifest_file, cards, tmp_path, capsys
):
    command = [
        "bench",
        "grid",
        str(manifest_file),
        "--out",
        str(tmp_path / "grid"),
        "--plugin",
        cards,
        "--edits",
        "1",
    ]
    command += [
        "--editor",
        "oracle,none,recolor",
        "--recon",
        "cards,noposplat",
        "--no-effnet",
        "--rasterizer",
        "torch",
    ]
    assert main([*command, "--set", "reconstructor.cards.depth=2.5"]) == 0
    table = (tmp_path / "grid" / "grid.md").read_text()
    lines = [
        line[1:-1].split("|") for line in table.splitlines() if line.startswith("|")
    ]
    rows = {cells[0].strip(): [cell.strip() for cell in cells] for cells in lines}
    pairs = [
        f"{editor}+{recon}"
        for editor in ("oracle", "none", "recolor")
        for recon in ("cards", "noposplat")
    ]
    assert set(pairs) < set(rows)
    assert float(rows["oracle+cards"][3]) > 0.1 and rows["oracle+cards"][-1] == ""
    assert (
        "left the reference as it was" in rows["none+cards"][-1]
        and rows["none+cards"][2] == "0"
    )
    assert (
        rows["recolor+cards"][2] == "1"
        and "No change of colour found in 'add an object'" in rows["recolor+cards"][-1]
    )
    assert all(
        "ships no weights" in rows[pair][-1] and rows[pair][2] == "1"
        for pair in pairs
        if "noposplat" in pair
    )
    page = (tmp_path / "grid" / "index.html").read_text()
    assert "ships no weights" in page and page.count("data:image/webp") >= 5
    before = page
    assert (
        main([*command, "--set", "reconstructor.cards.depth=2.5", "--quiet"]) == 0
    )  # nothing is measured again
    assert (tmp_path / "grid" / "index.html").read_text() == before


def test_all_that_is_installed_is_in_the_grid_and_nothing_is_asked_of_the_network():
    registry = default_registry()
    pairs = pairs_of(registry, {}, {}, {})
    installed = {
        kind: {o.component.name for o in registry.offers(kind)}
        for kind in ("editor", "reconstructor")
    }
    assert len(pairs) == (len(installed["editor"]) + 1) * len(
        installed["reconstructor"]
    )
    assert {method.editor.name for method, _ in pairs.values()} == {
        ORACLE,
        *installed["editor"],
    }
    skipped = {
        method.editor.name
        for method, why in pairs.values()
        if "name it to include it" in why
    }
    assert {"gpt-image", "gemini-image"} <= skipped and not skipped & {
        ORACLE,
        "none",
        "recolor",
        "instruct-pix2pix",
    }


def test_settings_of_what_is_not_in_the_grid_are_refused():
    asked = {"editor": ["none"], "reconstructor": ["classical"]}
    with pytest.raises(SettingsError, match=r"reconstructor\.refit: expected"):
        pairs_of(
            default_registry(), asked, {}, {"reconstructor": {"refit": {"steps": 3}}}
        )
