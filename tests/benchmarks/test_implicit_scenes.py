"""The second generator: exact cameras and depth, edits that change what they should, nothing shared
with the first.
"""

import ast
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from edit3r_bench.metrics import warped_difference, warped_image

from edit3r import default_registry
from edit3r_testing import DatasetContract

FILE = Path(__file__).parents[2] / "benchmarks/implicit_scenes.py"
REGISTRY = default_registry((str(FILE),))
K = np.array([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]])
BUILT = REGISTRY.build("dataset", "implicit")
implicit = sys.modules["implicit_scenes"]


@pytest.mark.slow
class TestContract(DatasetContract):
    component = "implicit"
    plugin_files = (str(FILE),)


def sample(index=0, **settings):
    asked = {"image_size": 64, "context": 3, "targets": 0, **settings}
    return REGISTRY.build("dataset", "implicit", **asked)[index]


def test_a_ball_is_seen_where_and_as_far_as_geometry_says():
    # no waves: both sums are 0, so that the pattern is even
    plain = np.zeros((2, 5, 4))
    sky = implicit.Body(implicit.DOME, np.zeros(3), np.ones(3), np.zeros((3, 3)), plain)
    ball = implicit.Body(
        implicit.BALL,
        np.array([0.0, 0.0, 4.0]),
        np.ones(3),
        np.full((3, 3), 0.5),
        plain,
    )
    image, depth = implicit.render([sky, ball], np.eye(4), K, 101)
    assert depth[50, 50] == pytest.approx(3.0, abs=2e-3)  # its nearest point
    # The rim of a ball of radius 1 at distance 4 is asin(1 / 4) off the axis: 0.258 widths, 26
    # pixels.
    row = depth[50] < 8
    assert row.sum() == pytest.approx(2 * 101 * np.tan(np.arcsin(0.25)), abs=1.5)
    assert image[50, 50].mean() > 0.2 and image[0, 0].max() == 0


def test_depth_and_poses_carry_every_view_onto_the_others():
    views = sample()
    pairs = [(a, b) for a in range(3) for b in range(3) if a != b]
    same = warped_difference(
        views.context, views.context_depths, views.context_cameras, pairs
    )
    seen = warped_image(
        views.context[1],
        *views.context_depths[:2],
        views.context_cameras.select([0, 1]),
    )[1]
    assert same < 0.03 and seen.float().mean() > 0.6
    swapped = warped_difference(
        views.context,
        views.context_depths,
        views.context_cameras.select([1, 0, 2]),
        [(0, 1)],
    )
    assert not swapped < 2 * same


@pytest.mark.parametrize("edit", ["add", "remove", "recolor", "global"])
def test_an_edit_changes_its_part_of_every_view(edit):
    views = sample(edit=edit)
    changed = (
        ((views.edited_context - views.context).abs().amax(1) > 1 / 255)
        .float()
        .mean((1, 2))
    )
    assert (changed > (0.8 if edit == "global" else 0.001)).all() and (
        edit == "global" or (changed < 0.5).all()
    )


@pytest.mark.slow
def test_added_things_are_those_that_are_removed():
    assert torch.equal(sample(edit="add").edited_context, sample(edit="remove").context)
    assert torch.equal(sample(edit="add").context, sample(edit="remove").edited_context)


@pytest.mark.slow
def test_seed_and_index_say_it_all():
    assert torch.equal(sample(3).context, sample(3).context)
    assert not torch.equal(sample(3).context, sample(4).context)
    assert not torch.equal(sample(3).context, sample(3, seed=1).context)
    recolored = [
        sample(3, edit="recolor", edit_seed=seed).edited_context for seed in (0, 1)
    ]
    assert (
        not torch.equal(*recolored)
        and len(implicit.draw_scene(np.random.default_rng(0))) >= 7
    )


def test_it_imports_nothing_of_the_first_generator_and_reads_no_file():
    tree = ast.parse(FILE.read_text())
    modules = {
        node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)
    }
    modules |= {
        alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
    }
    assert not any(
        name.startswith(("edit3r_", "skimage", "cv2", "pathlib", "PIL"))
        for name in modules
    )
