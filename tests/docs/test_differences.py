"""What differs from the paper is said where a reader of its numbers looks."""

import re
from pathlib import Path

import pytest
from edit3r_bench.features import CROPS, crops
from edit3r_bench.report import EXPLANATION
from edit3r_recolor.scene import RecoloringSettings
from torch import rand

from edit3r.kit.files.configs import find_config

DOCS = Path(__file__).parents[2] / "docs"
NUMBERS = {5: "five", 8: "eight"}


@pytest.mark.parametrize(
    ("page", "words"),
    [
        ("benchmark.md", "five crops of each rendering"),
        ("network.md", "(`weights_left_over`)"),
        ("training.md", "Dynamic scenes and long sequences"),
        ("photos.md", "scenes in motion over time are not done"),
    ],
)
def test_the_page_says_it(page, words):
    assert words in (DOCS / page).read_text()


def test_the_report_says_how_many_pieces_a_distance_compares():
    assert len(crops(rand(1, 3, 8, 8))) == CROPS
    assert f"compare {NUMBERS[CROPS]} crops of each rendering" in EXPLANATION


def test_the_papers_recipe_asks_for_all_objects_and_the_page_says_how_many_else():
    field = RecoloringSettings.model_fields["max_objects"]
    [most] = (one.le for one in field.metadata if hasattr(one, "le"))
    recipe = find_config("training/edit3r-paper").read_text()
    assert (
        re.search(r"edit3r recolor .*--set max_objects=(\d+)", recipe)[1] == f"{most}"
    )
    page = (DOCS / "recoloring.md").read_text()
    assert f"At most {NUMBERS[field.default]} objects" in page
    assert f"`--set max_objects={most}`" in page
