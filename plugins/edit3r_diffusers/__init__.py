"""The paper's 2D editors through Hugging Face diffusers."""

from edit3r import Component, hookimpl

EDIT3R_API = 1

_REQUIRES = ("diffusers", "transformers", "accelerate")
_NEEDS_WEIGHTS = "needs weights: downloaded on first use, or editor.model=FOLDER"


@hookimpl
def register_editors():
    return (
        Component(
            name="instruct-pix2pix",
            target="edit3r_diffusers.instruct_pix2pix:InstructPix2PixEditor",
            summary=f"InstructPix2Pix, the paper's default editor; {_NEEDS_WEIGHTS} (4 GB)",
            requires=_REQUIRES,
            extra="diffusers",
            licence="Apache-2.0; default weights MIT",
            needs_network=True,
            citation="Brooks et al., InstructPix2Pix: Learning to Follow Image Editing Instructions, CVPR 2023",
        ),
    )
