"""The pages on editors say what is true: the example runs, every named setting exists, every editor
has its page.
"""

import re
from pathlib import Path

import pytest
import torch

import edit3r
from edit3r.contract.types import EditRequest, Views
from edit3r.loading.load import load_plugins
from edit3r.loading.registry import Registry, default_registry

PAGES = Path(__file__).parents[2] / "docs" / "editors"
PLUGINS = ("diffusers", "remote")
SHARED = (
    "diffusers",
    "flux-kontext",
    "flux2-klein",
    "longcat-image-edit",
    "qwen-image-edit",
)
"""Editors that are one class with other weights, on one page."""


def page_of(editor: str) -> str:
    return "diffusers" if editor in SHARED else editor


@pytest.fixture
def lamp(tmp_path):
    text = (PAGES / "write-an-editor.md").read_text()
    source = re.search(r'```python title="lamp.py"\n(.*?)```', text, re.DOTALL).group(1)
    (tmp_path / "lamp.py").write_text(source)
    return source, Registry(load_plugins([tmp_path / "lamp.py"])).build(
        "editor", "lamp", power=0.9
    )


def test_the_thirty_line_editor_has_about_thirty_lines_and_keeps_its_contract(lamp):
    source, editor = lamp
    assert len([line for line in source.splitlines() if line.strip()]) <= 30
    views = Views(torch.rand(1, 2, 3, 20, 30), torch.eye(3).expand(1, 2, 3, 3))
    edited = editor.edit(views, EditRequest("", seed=3)).images
    assert (
        edited.shape == views.images.shape and edited.min() >= 0 and edited.max() <= 1
    )
    assert torch.equal(editor.edit(views, EditRequest("", seed=3)).images, edited)
    assert not torch.equal(editor.edit(views, EditRequest("", seed=4)).images, edited)


def test_every_editor_with_weights_or_a_key_has_a_page_in_the_table():
    table = (PAGES / "index.md").read_text()
    for offer in edit3r.components("editor"):
        if offer.plugin in PLUGINS:
            page = f"{page_of(offer.component.name)}.md"
            assert (
                offer.component.name in (PAGES / page).read_text()
                and f"({page})" in table
            )


@pytest.mark.parametrize(
    ("kind", "name", "page"),
    [
        ("editor", o.component.name, page_of(o.component.name))
        for o in edit3r.components("editor")
        if o.plugin in PLUGINS
    ]
    + [("segmenter", "sam2", "sam2"), ("segmenter", "sam3", "sam3")],
)
def test_settings_and_extras_a_page_names_exist(kind, name, page):
    text = (PAGES / f"{page}.md").read_text()
    registry = default_registry()
    offer = registry.find(kind, name)
    if registry.missing(offer):
        pytest.skip(f"{name} is not installed")
    known = set(registry.settings_class(offer).model_fields)
    named = set(re.findall(rf"\b{kind}\.(\w+)", text))
    assert named and named <= known
    assert f"edit3r[{offer.component.extra}]" in text
