"""Every registered component keeps its kind's contract: one test per component.

A component that needs files, a key or large weights is tried by its own tests, on small stand-ins
of them; it is named here with the reason, so that nothing is left out in silence.
"""

import subprocess
import sys
import unittest
from functools import cache
from pathlib import Path

import pytest

from edit3r.contract.component import Offer
from edit3r.loading.registry import default_registry
from edit3r_testing import CONTRACTS, Contract, claims, contract_for
from edit3r_testing.contract import HEAVY

SMALL_VIT = {
    "width": 32,
    "depth": 4,
    "heads": 2,
    "decoder_width": 24,
    "decoder_depth": 4,
    "decoder_heads": 2,
}
SMALL_DPT = {
    "feature_width": 8,
    "point_width": 8,
    "layer_widths": (4, 4, 8, 8),
    "harmonics_degree": 1,
}

SETTINGS: dict[tuple[str, str], dict] = {
    ("reconstructor", "noposplat"): {
        "backbone": {"name": "asymmetric-vit", **SMALL_VIT},
        "head": {"name": "dpt-gaussian", **SMALL_DPT},
        "weights": "random",
    },
    ("backbone", "asymmetric-vit"): SMALL_VIT,
    ("head", "dpt-gaussian"): SMALL_DPT,
    ("writer", "mesh"): {"detail": 0.1},
    ("dataset", "procedural"): {"image_size": 32, "textures": 8, "edit": "recolor"},
}
"""What makes a component quick enough for a test; its default settings otherwise."""

ATTRIBUTES: dict[tuple[str, str], dict] = {
    ("editor", "recolor"): {"prompt": "make everything red"},
    ("editor", "retouch"): {"masked": True, "image_size": (24, 32)},
    ("editor", "looks"): {"prompt": "make it look like autumn"},
    ("backbone", "matched-unet"): {"patches": (8, 12)},
    ("matcher", "classical"): {"image_size": (96, 128)},
    ("refiner", "refine"): {"image_size": (12, 16)},
    ("refiner", "simplify"): {"image_size": (12, 16)},
}
"""What its contract needs to know, and photos that are large enough to break what can break."""

DECLARATION_ONLY: dict[tuple[str, str], str] = {
    ("segmenter", "sam-onnx"): "needs weights of 151 MB",
    ("detector", "coco"): "needs weights of 8 MB",
    ("editor", "folder"): "needs an edited picture of each view",
    ("editor", "command"): "needs a program",
    ("editor", "style"): "needs weights of 3 MB and a picture",
    ("editor", "instruct-pix2pix"): "needs weights of 4 GB",
    ("editor", "diffusers"): "needs a class and weights",
    ("editor", "flux-kontext"): "needs weights of 34 GB",
    ("editor", "qwen-image-edit"): "needs weights of 58 GB",
    ("editor", "flux2-klein"): "needs weights of 16 GB",
    ("editor", "longcat-image-edit"): "needs weights of 29 GB",
    ("editor", "controlnet-depth"): "needs weights of 6 GB",
    (
        "reconstructor",
        "refit",
    ): "fits for minutes, and begins from a matcher that needs seconds a scene",
    ("reconstructor", "in-place"): "needs a scene to edit",
    ("reconstructor", "instruct-nerf2nerf"): "as refit",
    ("reconstructor", "gaussctrl"): "as refit",
    ("reconstructor", "editsplat"): "as refit",
    (
        "matcher",
        "posed",
    ): "does what the matcher classical does where the views carry no poses",
    ("matcher", "da3"): "needs a package outside the pinned set",
    ("matcher", "auto"): "does what the matcher it picks does",
    ("segmenter", "sam2"): "needs weights of 0.2 GB",
    ("segmenter", "sam3"): "needs weights of 3.5 GB",
    ("detector", "grounding-dino"): "needs weights of 0.7 GB",
    ("dataset", "transforms"): "needs a folder of scenes",
    ("dataset", "re10k"): "needs downloaded chunks",
    ("trainer", "recolor"): "trains the network of reconstructor 'edit3r' only",
}
"""Only claims about the declaration are tried here; the others in the component's own tests."""

PLUGIN_TESTS = Path(__file__).with_name("plugins")

TRIED_IN: dict[tuple[str, ...], str] = {
    ("command",): "edit3r_editors/test_command.py",
    ("folder",): "edit3r_editors/test_folder.py",
    ("style",): "edit3r_editors/test_style.py",
    (
        "controlnet-depth",
        "diffusers",
        "flux-kontext",
        "flux2-klein",
        "instruct-pix2pix",
        "longcat-image-edit",
        "qwen-image-edit",
    ): "edit3r_diffusers/test_contract.py",
    ("gemini-image", "gpt-image"): "edit3r_remote/test_contract.py",
    ("local-model", "model"): "edit3r_language/test_model.py",
    (
        "sam2",
        "sam3",
        "sam-onnx",
        "grounding-dino",
    ): "edit3r_segmenters/test_contract.py",
    ("coco",): "edit3r_segmenters/test_words.py",
    (
        "editsplat",
        "gaussctrl",
        "instruct-nerf2nerf",
        "refit",
    ): "edit3r_optimisers/test_methods.py",
    ("in-place",): "edit3r_in_place/test_in_place.py",
    ("auto", "posed"): "edit3r_geometry/test_posed_matcher.py",
    ("da3",): "edit3r_geometry/test_depth_anything_3.py",
    ("clip",): "edit3r_bench/test_clip.py",
    ("lpips",): "edit3r_training/test_losses.py",
    ("re10k", "transforms"): "edit3r_training/test_photo_datasets.py",
    ("recolor",): "edit3r_training/test_recolor_trainer.py",
}
"""Where the whole contract of those is tried that are left out here."""


@cache
def bound(offer: Offer) -> type[Contract]:
    """The component's contract; one class for all claims, so that the component is built once."""
    key = (offer.kind, offer.component.name)
    contract = contract_for(offer.kind, offer.qualified_name, **SETTINGS.get(key, {}))
    for name, value in ATTRIBUTES.get(key, {}).items():
        setattr(contract, name, value)
    return contract


def is_left_out(offer: Offer) -> bool:
    key = offer.kind, offer.component.name
    return offer.component.needs_network or key in DECLARATION_ONLY


def own_tests(offer: Offer) -> Path:
    """The file of the component's own tests that tries the whole contract on it."""
    name = offer.component.name
    found = [file for names, file in TRIED_IN.items() if name in names]
    assert found, f"{name}: TRIED_IN must name the file that tries its contract"
    return PLUGIN_TESTS / found[0]


SLOW = {
    ("matcher", "classical"),
    ("reconstructor", "classical"),
    ("reconstructor", "edit3r"),
    ("reconstructor", "noposplat"),
    ("loss", "perceptual"),
    ("refiner", "refine"),
    ("refiner", "simplify"),
    ("segmenter", "auto"),
    ("selector", "by-segmenter"),
    ("selector", "in-scene"),
    ("critic", "limits"),
}
"""Components whose contract takes half a CPU second or more."""

OFFERS = [
    pytest.param(
        offer,
        id=f"{offer.kind}-{offer.qualified_name}",
        marks=[pytest.mark.slow] * ((offer.kind, offer.component.name) in SLOW),
    )
    for offer in default_registry().offers()
]


@pytest.mark.parametrize("offer", OFFERS)
def test_a_component_keeps_its_contract(offer: Offer):
    """All that is wrong with it, in one message."""
    broken = [
        f"{claim}: {why}"
        for claim in claims_here(offer)
        if (why := fault(offer, claim)) is not None
    ]
    assert not broken, "\n".join(broken)


def claims_here(offer: Offer) -> list[str]:
    """The claims that are tried here; for what is left out, those about the declaration."""
    every = claims(Contract) if is_left_out(offer) else claims(CONTRACTS[offer.kind])
    return [claim for claim in every if claim not in IN_ONE_PROCESS]


IN_ONE_PROCESS = (
    "test_declaration_imports_nothing_heavy",
    "test_arguments_are_declared_without_importing_torch",
)
"""Claims that need a process of their own: one for all components."""

DECLARE_ALL = """
import sys
from edit3r.cli.main import Parser
from edit3r.loading.registry import default_registry

def check(what):
    loaded = [name for name in {heavy!r} if name in sys.modules]
    if loaded:
        sys.exit(what + " imports " + ", ".join(loaded))

registry = default_registry()
registry.offers()
check("a plugin's declaration")
for offer in registry.offers("command"):
    command = registry.build("command", offer.qualified_name)
    command.add_arguments(Parser(prog="edit3r"))
    check("declaring the arguments of " + offer.qualified_name)
print(len(registry.offers("command")))
"""


def test_nothing_heavy_is_imported_to_declare_components_and_arguments():
    code = DECLARE_ALL.format(heavy=HEAVY)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) == len(default_registry().offers("command"))


def fault(offer: Offer, claim: str) -> str | None:
    """What is wrong with one claim; None where it holds or does not apply."""
    try:
        getattr(bound(offer)(), claim)()
    except (pytest.skip.Exception, unittest.SkipTest):
        return None
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return None


def test_what_is_left_out_here_is_tried_by_its_own_plugin():
    for offer in filter(is_left_out, default_registry().offers()):
        assert "Contract" in own_tests(offer).read_text(), offer.qualified_name


def test_every_plugin_of_the_installation_loads():
    assert [
        f"{failure.plugin}: {failure.reason}" for failure in default_registry().failures
    ] == []


def test_no_two_components_of_a_kind_share_a_name():
    assert default_registry().clashes() == []


def test_every_exception_and_every_setting_names_a_component_that_exists():
    known = {
        (offer.kind, offer.component.name) for offer in default_registry().offers()
    }
    assert {*SETTINGS, *ATTRIBUTES, *DECLARATION_ONLY} <= known
