"""Every table that `docs/figures.py` remakes stands on its page, as its command printed it."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
spec = importlib.util.spec_from_file_location("docs_figures", ROOT / "docs/figures.py")
figures = importlib.util.module_from_spec(spec)
spec.loader.exec_module(figures)


@pytest.mark.parametrize("name", figures.TABLES)
def test_the_command_of_each_table_exists_with_its_options(name):
    program, script, *arguments = figures.TABLES[name].command.split()
    code = (ROOT / script).read_text(encoding="utf-8")
    assert program == "python"
    for option in [word for word in arguments if word.startswith("--")]:
        assert f'"{option}"' in code, f"{script} has no {option}"


@pytest.mark.parametrize("name", figures.TABLES)
def test_each_table_is_on_its_page_as_it_was_made_and_names_its_command(name):
    text = (ROOT / figures.TABLES[name].page).read_text(encoding="utf-8")
    _, table, commit, _ = figures.parts(text, name).groups()
    assert f"Measured at `{commit}` by `{figures.TABLES[name].command}`." in text
    assert re.search(r"(?m)^\| -", table)
    assert not figures.complaint(text, name, commit)


def test_check_notices_a_changed_table_and_older_code():
    empty = "before\n<!-- figures: x -->\n<!-- end of figures formats new -->\nafter\n"
    page = figures.replaced(empty, "formats", "| a |\n| - |\n| 1.5 |", "abc1234")
    assert page.startswith("before\n<!-- figures: python") and page.endswith("after\n")
    assert not figures.complaint(page, "formats", "abc1234")
    by_hand = page.replace("1.5", "1.4")
    assert "by hand" in figures.complaint(by_hand, "formats", "abc1234")
    assert "is of abc1234" in figures.complaint(page, "formats", "def5678")
    again = figures.replaced(page, "formats", "| b |", "def5678")
    assert "| a |" not in again and again.count("<!--") == 2
