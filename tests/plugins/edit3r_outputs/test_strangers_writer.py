"""A stranger's format, written from the page about writers alone, is taken wherever ours are."""

import ast
import sys
import zipfile
from pathlib import Path

import pytest
from PIL import Image

from edit3r.cli.main import main
from edit3r.kit.photos.images import packaged_pair
from edit3r_testing import claims, contract_for

FLAT = Path(__file__).parents[1] / "flat_scene.py"
PROMISED = ("edit3r", "edit3r.contract", "edit3r.kit.geometry", "edit3r_testing")

DECLARATION = '''"""Scenes as USDZ, for AR on phones."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_writers():
    return [
        Component(
            "usdz",
            "edit3r_usdz.writer:UsdzWriter",
            "coloured points for AR on phones",
            suffix=".usdz",
            keeps="centres, sizes and plain colours",
            loses="shapes, opacities, harmonics",
        )
    ]
'''
WRITER = '''"""USD as text, in an archive in which each file lies at a multiple of 64 bytes."""

import zipfile

from edit3r.contract.interfaces import Writer
from edit3r.kit.geometry.harmonics import dc_to_colour

HEAD = """#usda 1.0
( defaultPrim = "Scene" upAxis = "Y" )
def Points "Scene" {
"""


class UsdzWriter(Writer):
    """The Gaussians as points, y up."""

    def write(self, path, scene):
        gaussians = scene.gaussians.to("cpu")
        means = gaussians.means[0] * gaussians.means.new_tensor([1, -1, -1])
        colours = dc_to_colour(gaussians.harmonics[0, :, 0]).clamp(0, 1)
        widths = ", ".join(f"{2 * size:.4g}" for size in gaussians.scales[0].mean(1))
        text = f"{HEAD}    point3f[] points = [{rows(means)}]\\n"
        text += f"    color3f[] primvars:displayColor = [{rows(colours)}]\\n"
        text += f"    float[] widths = [{widths}]\\n}}\\n"
        file = zipfile.ZipInfo("scene.usda", date_time=(1980, 1, 1, 0, 0, 0))
        padding = -(30 + len(file.filename) + 4) % 64
        file.extra = b"\\x00\\x00" + padding.to_bytes(2, "little") + bytes(padding)
        with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
            archive.writestr(file, text)


def rows(values):
    return ", ".join("(%.4g, %.4g, %.4g)" % tuple(row) for row in values.tolist())
'''


@pytest.fixture
def usdz(tmp_path):
    """The folder of the stranger's package."""
    package = tmp_path / "theirs" / "edit3r_usdz"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(DECLARATION)
    (package / "writer.py").write_text(WRITER)
    yield package
    for module in [name for name in sys.modules if name.startswith("edit3r_usdz")]:
        del sys.modules[module]


def points_of(file):
    """The number of points in a USDZ, whose only file must lie at a multiple of 64 bytes."""
    with zipfile.ZipFile(file) as archive:
        (entry,) = archive.infolist()
        text = archive.read(entry).decode()
    assert file.read_bytes().index(b"#usda") % 64 == 0
    return text.split("points = ")[1].split("]")[0].count("(")


def test_it_is_short_and_uses_what_is_promised():
    imported = [
        name
        for text in (DECLARATION, WRITER)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.ImportFrom)
        and (name := node.module).startswith("edit3r")
    ]
    assert imported and all(name.startswith(PROMISED) for name in imported)
    assert len(WRITER.splitlines()) < 40


def test_it_keeps_its_contract(usdz):
    contract = contract_for("writer", "usdz", (usdz,))
    for claim in claims(contract):
        getattr(contract(), claim)()


def test_a_run_and_an_export_take_it_by_its_name(usdz, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name, photo in zip("ab", packaged_pair()[0]):
        Image.open(photo).resize((48, 32)).save(f"{name}.png")
    parts = f"--editor none --recon flat --rasterizer torch --plugin {FLAT}"
    small = "--size 24 --refine 0 --gaussians all --plugin"
    run = f"run a.png b.png {parts} {small} {usdz} --quiet --out out --outputs"
    assert main([*run.split(), "scene,usdz"]) == 0
    made = Path("out/scene.usdz")
    count = points_of(made)
    assert count > 100

    export = f"export out --to usdz --plugin {usdz} --out copy.usdz"
    assert main(export.split()) == 0
    assert points_of(Path("copy.usdz")) == count
    assert main(f"list-plugins --kind writer --plugin {usdz}".split()) == 0
    assert "usdz keeps centres, sizes and plain colours" in capsys.readouterr().out
