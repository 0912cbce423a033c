"""The contract of editors, kept on tiny random models."""

from pathlib import Path

import pytest

from edit3r_testing import CONTRACTS, Contract, claims, contract_for

pytestmark = pytest.mark.slow

FLAT = Path(__file__).parents[1] / "flat_scene.py"


@pytest.fixture(scope="module")
def contracts(tiny):
    """One contract per editor, so that each is built once for all claims."""
    cheap = {"steps": 1, "resolution": 0, "local_files_only": True}
    depth = {"controlnet": str(tiny.controlnet()), "matcher": "flat"}
    settings = {
        "instruct-pix2pix": {"model": str(tiny.instruct_pix2pix()), **cheap},
        "flux-kontext": {"model": str(tiny.flux_kontext()), **cheap},
        "flux2-klein": {"model": str(tiny.flux2_klein()), **cheap, "resolution": 96},
        "controlnet-depth": {"model": str(tiny.stable_diffusion()), **depth, **cheap},
        "qwen-image-edit": {"model": str(tiny.qwen_image_edit()), **cheap},
        "longcat-image-edit": {"model": str(tiny.longcat_image_edit()), **cheap},
        "diffusers": {
            "model": str(tiny.instruct_pix2pix()),
            "pipeline": "StableDiffusionInstructPix2PixPipeline",
            **cheap,
        },
    }
    bound = {
        name: contract_for("editor", name, **chosen)
        for name, chosen in settings.items()
    }
    for contract in bound.values():
        contract.plugin_files = (FLAT,)
        contract.image_size = (24, 32)
    return bound


EVERY = sorted({*claims(CONTRACTS["editor"])} - {*claims(Contract)})
ONE_BY_ONE = "test_any_number_of_views_and_scenes"  # half of the time of all claims
ALL_OF_IT = ("instruct-pix2pix", "flux2-klein", "controlnet-depth")
SAME_LOOP = ("flux-kontext", "qwen-image-edit", "longcat-image-edit", "diffusers")
"""These edit by the loop over views of flux2-klein."""


@pytest.mark.parametrize(
    ("editor", "claim"),
    [(editor, claim) for editor in ALL_OF_IT for claim in EVERY]
    + [
        (editor, claim)
        for editor in SAME_LOOP
        for claim in EVERY
        if claim != ONE_BY_ONE
    ],
)
def test_contract(contracts, editor, claim):
    getattr(contracts[editor](), claim)()
