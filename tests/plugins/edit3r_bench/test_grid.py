"""The grid: every editor with every reconstructor, and a row with its sentence for each pair that
gives nothing.
"""

import pytest
from edit3r_bench.grid import pairs_of
from edit3r_bench.options import RunOptions
from edit3r_bench.oracle import ORACLE

from edit3r.cli.main import main
from edit3r.contract.errors import SettingsError
from edit3r.loading.registry import default_registry


@pytest.mark.slow
def test_every_pair_is_a_row_and_failures_say_why(manifest_file, cards, tmp_path):
    command = (
        f"bench grid {manifest_file} --out {tmp_path} --plugin {cards} --edits 1 --no-effnet "
        "--editor oracle,none,recolor --recon cards,noposplat --rasterizer torch --quiet "
        "--set reconstructor.cards.depth=2.5"
    )
    assert main(command.split()) == 0
    file = tmp_path / "grid.md"
    rows = {}
    for line in file.read_text().splitlines():
        if line.startswith("| "):
            label, *cells = (cell.strip() for cell in line.strip("|").split("|"))
            rows[label] = cells
    assert float(rows["oracle+cards"][3]) > 0.1
    assert rows["oracle+cards"][-1] == ""
    assert "left the reference as it was" in rows["none+cards"][-1]
    assert rows["none+cards"][:3] == ["1", "1", "0"]
    assert "'add an object'" in rows["recolor+cards"][-1]
    for editor in ("oracle", "none", "recolor"):
        assert "ships no weights" in rows[f"{editor}+noposplat"][-1]
        assert rows[f"{editor}+noposplat"][2] == "1"
    before = file.read_text()
    assert main(command.split()) == 0  # nothing is measured again
    assert file.read_text() == before


def test_all_that_is_installed_is_in_the_grid_and_nothing_is_asked_of_the_network():
    registry = default_registry()
    pairs = pairs_of(registry, RunOptions(), {})
    installed = {}
    for kind in ("editor", "reconstructor"):
        installed[kind] = {offer.component.name for offer in registry.offers(kind)}
    editors = {ORACLE, *installed["editor"]}
    assert len(pairs) == len(editors) * len(installed["reconstructor"])
    assert {pair.method.editor.name for pair in pairs} == editors
    skipped = {pair.method.editor.name for pair in pairs if pair.skipped}
    assert {"gpt-image", "gemini-image"} <= skipped  # and what needs an extra


def test_settings_of_what_is_not_in_the_grid_are_refused():
    asked = RunOptions(editor="none", reconstructor="classical")
    settings = {"reconstructor": {"refit": {"steps": 3}}}
    with pytest.raises(SettingsError, match=r"reconstructor\.refit: expected"):
        pairs_of(default_registry(), asked, settings)
