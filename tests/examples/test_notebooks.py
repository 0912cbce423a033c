"""The notebooks run from top to bottom, without Jupyter."""

import ast
import json
import warnings
from pathlib import Path

import pytest

NOTEBOOKS = sorted(
    (Path(__file__).parents[2] / "examples" / "notebooks").glob("*.ipynb")
)


@pytest.mark.slow
@pytest.mark.parametrize("file", NOTEBOOKS, ids=[file.stem for file in NOTEBOOKS])
def test_every_cell_runs_and_its_last_value_can_be_shown(file):
    book = json.loads(file.read_text(encoding="utf-8"))
    names: dict = {"__name__": "__main__"}
    shown = []
    for cell in book["cells"]:
        assert cell["cell_type"] == "markdown" or not cell["outputs"], (
            "a notebook is kept without outputs"
        )
        if cell["cell_type"] == "code":
            tree = ast.parse("".join(cell["source"]))
            last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                exec(compile(tree, file.name, "exec"), names)
                if last is not None:
                    shown.append(
                        eval(
                            compile(ast.Expression(last.value), file.name, "eval"),
                            names,
                        )
                    )
    assert any(
        "<iframe" in value._repr_html_()
        for value in shown
        if hasattr(value, "_repr_html_")
    )
    assert all(len(repr(value)) < 2000 for value in shown)
    assert "scene.ply" in shown[-1]


def test_there_is_a_notebook():
    assert NOTEBOOKS
