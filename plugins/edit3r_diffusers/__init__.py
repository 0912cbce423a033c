"""2D editors through Hugging Face diffusers: the paper's, and any other editing pipeline by the
name of its class.
"""

from edit3r import Component, hookimpl
from edit3r.contract.weights import Weights

EDIT3R_API = 1

_SD15 = (
    ("model_index.json", ""),
    ("*/*.json", ""),
    ("*/*.txt", ""),
    ("text_encoder/model.safetensors", ""),
    ("unet/diffusion_pytorch_model.safetensors", ""),
    ("vae/diffusion_pytorch_model.safetensors", ""),
)

_INSTRUCT_PIX2PIX = Weights(
    "instruct-pix2pix",
    "editor instruct-pix2pix",
    4_270_000_000,
    "MIT; from Stable Diffusion 1.5, CreativeML Open RAIL-M",
    "yes",
    "hub:timbrooks/instruct-pix2pix",
    "31519b5cb02a7fd89b906d88731cd4d6a7bbf88d",
    _SD15,
)
_STABLE_DIFFUSION = Weights(
    "stable-diffusion-1-5",
    "editor controlnet-depth",
    4_270_000_000,
    "CreativeML Open RAIL-M",
    "yes",
    "hub:stable-diffusion-v1-5/stable-diffusion-v1-5",
    "451f4fe16113bff5a5d2269ed5ad43b0592e9a14",
    _SD15,
)
_CONTROLNET = Weights(
    "controlnet-depth",
    "editor controlnet-depth",
    1_450_000_000,
    "CreativeML Open RAIL-M",
    "yes",
    "hub:lllyasviel/control_v11f1p_sd15_depth",
    "539f99181d33db39cf1af2e517cd8056785f0a87",
    (("config.json", ""), ("diffusion_pytorch_model.safetensors", "")),
)


ANY_ACTION = ("other", "paint", "look", "remove")


def _editor(name: str, target: str, summary: str, **more) -> Component:
    return Component(
        name,
        f"edit3r_diffusers.{target}",
        summary,
        requires=("diffusers", "transformers", "accelerate"),
        extra="diffusers",
        needs_network=True,
        **more,
    )


def _preset(
    name: str,
    target: str,
    summary: str,
    citation: str,
    size: int,
    hub: str,
    revision: str,
    **terms,
) -> Component:
    """An editor of `pipeline_editor` with its weights, Apache-2.0 unless `terms` say otherwise."""
    terms = {"licence": "Apache-2.0", "commercial": "yes", **terms}
    files = (("model_index.json", ""), ("*/*", ""))
    weights = Weights(
        name,
        f"editor {name}",
        size,
        source=f"hub:{hub}",
        revision=revision,
        files=files,
        **terms,
    )
    licence = f"Apache-2.0; default weights {weights.licence}"
    more = {
        "licence": licence,
        "citation": citation,
        "weights": (weights,),
        "actions": ANY_ACTION,
    }
    return _editor(name, f"pipeline_editor:{target}", summary, **more)


_PRESETS = (
    _preset(
        "flux-kontext",
        "FluxKontextEditor",
        "FLUX.1 Kontext, masks through its inpaint form (34 GB)",
        "Black Forest Labs, FLUX.1 Kontext: Flow Matching for In-Context Image Generation, 2025",
        34_000_000_000,
        "black-forest-labs/FLUX.1-Kontext-dev",
        "24e9dedc4ef646698dc8eb4e18ae2cec3c9fea0d",
        licence="FLUX.1 [dev] Non-Commercial License",
        commercial="no",
        gated=True,
    ),
    _preset(
        "qwen-image-edit",
        "QwenImageEditEditor",
        "Qwen-Image-Edit 2511, up to three pictures at once (58 GB)",
        "Wu et al., Qwen-Image Technical Report, 2025",
        57_700_000_000,
        "Qwen/Qwen-Image-Edit-2511",
        "6f3ccc0b56e431dc6a0c2b2039706d7d26f22cb9",
    ),
    _preset(
        "flux2-klein",
        "Flux2KleinEditor",
        "FLUX.2 klein 4B in four steps, several pictures at once, masks through its inpaint form "
        "(16 GB)",
        "Black Forest Labs, FLUX.2 [klein], 2026",
        15_980_141_329,
        "black-forest-labs/FLUX.2-klein-4B",
        "e7b7dc27f91deacad38e78976d1f2b499d76a294",
    ),
    _preset(
        "longcat-image-edit",
        "LongCatImageEditEditor",
        "LongCat-Image-Edit (29 GB)",
        "Meituan LongCat Team, LongCat-Image Technical Report, 2025",
        29_000_000_000,
        "meituan-longcat/LongCat-Image-Edit",
        "7b54ef423aa7854be7861600024be5c56ab7875a",
    ),
)

WEIGHTS = (
    _INSTRUCT_PIX2PIX,
    _STABLE_DIFFUSION,
    _CONTROLNET,
    *(weights for preset in _PRESETS for weights in preset.weights),
)
"""All that the editors here declare."""


@hookimpl
def register_editors():
    any_pipeline = _editor(
        "diffusers",
        "pipeline_editor:PipelineEditor",
        "any editing pipeline of diffusers: editor.pipeline=ClassName, editor.model=OWNER/NAME "
        "or FOLDER",
        licence="Apache-2.0; the weights have their own",
    )
    instruct_pix2pix = _editor(
        "instruct-pix2pix",
        "instruct_pix2pix:InstructPix2PixEditor",
        "InstructPix2Pix, the paper's default editor (4 GB)",
        licence="Apache-2.0; default weights MIT",
        citation="Brooks et al., InstructPix2Pix: Learning to Follow Image Editing Instructions, "
        "CVPR 2023",
        weights=(_INSTRUCT_PIX2PIX,),
        actions=ANY_ACTION,
    )
    controlnet_depth = _editor(
        "controlnet-depth",
        "controlnet_depth:ControlNetDepthEditor",
        "GaussCtrl-like depth ControlNet, DDIM inversion, cross-view attention (6 GB)",
        parts=("matcher",),
        licence="Apache-2.0; default weights CreativeML Open RAIL-M",
        min_views=2,  # to measure depth
        citation="Wu et al., GaussCtrl: Multi-View Consistent Text-Driven 3D Gaussian Splatting "
        "Editing, ECCV 2024",
        weights=(_STABLE_DIFFUSION, _CONTROLNET),
    )
    return (any_pipeline, instruct_pix2pix, *_PRESETS, controlnet_depth)
