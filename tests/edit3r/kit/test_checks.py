"""A component that returns something else than it promised is named where it happened."""

import importlib
import inspect
import re
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from edit3r.contract.component import Component, Offer, component_name
from edit3r.contract.errors import InputError, PluginError, SettingsError
from edit3r.contract.interfaces import (
    Editor,
    Rasterizer,
    Reconstructor,
    RefineInputs,
    Refiner,
)
from edit3r.contract.torch_state import require_device
from edit3r.contract.types import EditRequest, Reconstruction, Rendering
from edit3r.kit import asking
from edit3r.kit.checks import errors_named_after, where
from edit3r_testing import cameras_around, gaussian_cloud, photograph


class Sepia(Editor):
    answer = None

    def edit(self, views, request):
        return self.answer


class Lifted(Reconstructor):
    def __call__(self, views, source=None, geometry=None, grid=None):
        raise NotImplementedError


class Dense(Rasterizer):
    answer = None

    def render(self, gaussians, cameras):
        return self.answer


class Keeps(Refiner):
    def __init__(self, answer):
        self.answer = answer

    def __call__(self, gaussians, inputs):
        return self.answer


VIEWS = photograph(2, (8, 12)).views
CAMERAS_OF_2 = cameras_around(2)
GOOD = Reconstruction(gaussian_cloud(5), CAMERAS_OF_2)
CAMERAS = cameras_around(1, (8, 12))
DRAWN = Rendering(
    torch.zeros(1, 1, 3, 8, 12),
    torch.zeros(1, 1, 1, 8, 12),
    torch.zeros(1, 1, 1, 8, 12),
)


def gaussians(**fields):
    return replace(GOOD, gaussians=replace(GOOD.gaussians, **fields))


def edit(answer):
    sepia = Sepia()
    sepia.answer = answer
    return asking.edit(sepia, VIEWS, EditRequest("x"))


def reconstruct(answer):
    return asking.reconstruct(Lifted(), VIEWS, lambda: answer)


def render(answer):
    dense = Dense()
    dense.answer = answer
    return asking.render(dense, GOOD.gaussians, CAMERAS)


def test_what_keeps_its_promise_passes():
    assert edit(VIEWS) is VIEWS
    assert reconstruct(GOOD) is GOOD
    reconstruct(replace(GOOD, cameras=None))
    assert render(DRAWN) is DRAWN


def refused(ask, answer, kind, sentence):
    with pytest.raises(PluginError) as error:
        ask(answer)
    assert str(error.value).startswith(kind) and sentence in str(error.value)


@pytest.mark.parametrize(
    "answer, sentence",
    [
        (None, "must return edit3r.contract.types.Views, got NoneType"),
        (VIEWS.select([0]), "of shape [1, 2, 3, 8, 12], got [1, 1, 3, 8, 12]"),
        (
            replace(VIEWS, images=VIEWS.images.double()),
            "must return images in torch.float32, got torch.float64",
        ),
        (
            replace(VIEWS, images=VIEWS.images + 1),
            "must return images in [0, 1], got 1",
        ),
        (replace(VIEWS, images=VIEWS.images / 0), "not finite"),
    ],
)
def test_an_edit_that_is_not_one(answer, sentence):
    refused(edit, answer, "editor 'Sepia' ", sentence)


@pytest.mark.parametrize(
    "answer, sentence",
    [
        (
            GOOD.gaussians,
            "must return edit3r.contract.types.Reconstruction, got Gaussians",
        ),
        (
            Reconstruction(None),
            "must return edit3r.contract.types.Gaussians, got NoneType",
        ),
        (Reconstruction(gaussian_cloud(5, batch=2)), "gave it 1 scenes, got back 2"),
        (
            gaussians(scales=GOOD.gaussians.scales.double()),
            "must return scales in torch.float32, got torch.float64",
        ),
        (
            gaussians(means=GOOD.gaussians.means / 0),
            "returned means with 15 of 15 values not finite",
        ),
        (
            gaussians(scales=0 * GOOD.gaussians.scales),
            "must return scales above 0, got 0",
        ),
        (
            gaussians(opacities=2 + GOOD.gaussians.opacities),
            "must return opacities in [0, 1], got 2",
        ),
        (
            replace(GOOD, cameras=cameras_around(3)),
            "one camera per view, [1, 2], got [1, 3]",
        ),
        (
            replace(GOOD, cameras=replace(CAMERAS_OF_2, c2w=-CAMERAS_OF_2.c2w)),
            "whose first three columns are a rotation; one mirrors",
        ),
        (replace(GOOD, gaussians=gaussian_cloud(0)), "got an empty scene"),
        (
            replace(GOOD, placed=torch.zeros(1, 2, dtype=torch.bool)),
            "must place a view, or raise MatchingError",
        ),
        (
            replace(GOOD, placed=torch.ones(1, 3, dtype=torch.bool)),
            "must return placed for each of its views, [1, 2]",
        ),
        (
            replace(GOOD, measured=torch.ones(2)),
            "must return measured for each of its views, [1, 2], got [2]",
        ),
        (
            replace(GOOD, fusion=torch.zeros(1, 2, 1, 4, 4)),
            "must return fusion for each of its views, [1, 2, 3]",
        ),
    ],
)
def test_a_reconstruction_that_is_not_one(answer, sentence):
    refused(reconstruct, answer, "reconstructor 'Lifted' ", sentence)


@pytest.mark.parametrize(
    "answer, sentence",
    [
        ((1, 2, 3), "must return edit3r.contract.types.Rendering, got tuple"),
        (
            replace(DRAWN, images=DRAWN.images[0]),
            "must return images of shape [1, 1, 3, 8, 12], got [1, 3, 8, 12]",
        ),
        (
            replace(DRAWN, alphas=DRAWN.images),
            "must return alphas of shape [1, 1, 1, 8, 12]",
        ),
        (
            DRAWN.to(torch.float64),
            "must return images in torch.float32, got torch.float64",
        ),
        (
            replace(DRAWN, depths=DRAWN.depths / 0),
            "returned depths with 96 of 96 values not finite",
        ),
    ],
)
def test_a_rendering_that_is_not_one(answer, sentence):
    refused(render, answer, "rasterizer 'Dense' ", sentence)


def test_an_error_of_the_component_s_own_code_names_component_and_plugin():
    sepia = Sepia()
    sepia.offer = Offer("editor", Component("sepia", "m:C", ""), "old-photos", "1.0")
    assert component_name(sepia) == "sepia"
    with (
        pytest.raises(
            PluginError,
            match="editor 'sepia' of plugin 'old-photos' raised KeyError: 'x'",
        ),
        errors_named_after(sepia),
    ):
        raise KeyError("x")


def test_sentences_for_the_user_and_lack_of_memory_pass_unchanged():
    with (
        pytest.raises(InputError, match=r"^as it was$"),
        errors_named_after(SimpleNamespace()),
    ):
        raise InputError("as it was")
    with (
        pytest.raises(RuntimeError, match="out of memory"),
        errors_named_after(SimpleNamespace()),
    ):
        raise RuntimeError("CUDA out of memory")
    with pytest.raises(KeyboardInterrupt), errors_named_after(SimpleNamespace()):
        raise KeyboardInterrupt


def test_a_device_without_numbers_is_refused():
    with pytest.raises(SettingsError, match="'meta' cannot be used"):
        require_device("meta")


def test_arguments_that_a_component_changes_are_told():
    given = torch.ones(2, 3)
    with (
        pytest.raises(PluginError, match="must leave its arguments as they are"),
        errors_named_after(Sepia(), given),
    ):
        given.numpy()[0] = 0


def test_classes_are_named_as_a_plugin_imports_them():
    named = re.findall(r"require_type\(.+, (\w+)\)", inspect.getsource(asking))
    assert len(named) > 10 and "Proposal" in named
    for name in {*named} - {"tuple", "dict", "str"}:
        module, _, attribute = where(getattr(asking, name)).rpartition(".")
        promised = importlib.import_module(module)
        assert getattr(promised, attribute) is getattr(asking, name)
    assert where(tuple) == "tuple"


def test_a_refiner_must_leave_something_but_of_an_empty_scene():
    inputs = RefineInputs(CAMERAS_OF_2, VIEWS, Dense())
    none = GOOD.gaussians.select(torch.zeros(5, dtype=torch.bool))
    asking.refine(Keeps(none), none, inputs)
    with pytest.raises(PluginError, match="leave some of 5 Gaussians"):
        asking.refine(Keeps(none), GOOD.gaussians, inputs)
