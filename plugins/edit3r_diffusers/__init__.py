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
        Component(
            name="flux-kontext",
            target="edit3r_diffusers.flux_kontext:FluxKontextEditor",
            summary=f"FLUX.1 Kontext, masks through its inpaint form; {_NEEDS_WEIGHTS} (34 GB, gated)",
            requires=_REQUIRES,
            extra="diffusers",
            licence="Apache-2.0; default weights FLUX.1 [dev] Non-Commercial License",
            needs_network=True,
            citation="Black Forest Labs, FLUX.1 Kontext: Flow Matching for In-Context Image Generation, 2025",
        ),
        Component(
            name="controlnet-depth",
            target="edit3r_diffusers.controlnet_depth:ControlNetDepthEditor",
            summary=f"GaussCtrl-like depth ControlNet, DDIM inversion, cross-view attention; {_NEEDS_WEIGHTS} (6 GB)",
            requires=_REQUIRES,
            extra="diffusers",
            parts=("matcher",),
            licence="Apache-2.0; default weights CreativeML Open RAIL-M",
            needs_network=True,
            min_views=2,  # to measure depth; one is enough with editor.depth_model
            citation="Wu et al., GaussCtrl: Multi-View Consistent Text-Driven 3D Gaussian Splatting Editing, ECCV 2024",
        ),
    )
