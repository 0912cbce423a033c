"""The networks of the paper: photos without poses to 3D Gaussians in one pass, any number of views.

`reconstructor` has the reconstructors `edit3r` and `noposplat`: a backbone, a head, and one of two
forms. `matched_form`, with the small network whose weights ship, carries edits between views over
matched geometry: `matched_unet` and `edit_fusion_head`, whose trained parts are in `edit_fusion`
and whose rules are in `edited_views`, `colour_function` and `disagreement`.
`single_pass`, with the full network, finds geometry by itself: `view_fitting`, then
`asymmetric_vit` (of blocks in `transformer`) and `dpt_head`, whose raw maps become Gaussians in
`gaussian_adapter`.

`network` gives the parts their weights, which `checkpoints` and `official_checkpoints` read;
`engine` chooses the precision and brings loaded layers into it; `memory` has the limits. Written
from a description of the published network; no code of that family is used.
"""

from edit3r import Component, hookimpl
from edit3r.contract.weights import Weights

EDIT3R_API = 1

OFFICIAL = Weights(
    "edit3r-official",
    "the full network as the paper's authors trained it, for two views of 512x512",
    2_500_000_000,  # about: 612 million parameters in float32
    "as the card of its repository says: read it first; the network starts from NoPoSplat's and "
    "MASt3R's weights, which are CC BY-NC-SA 4.0",
    "unclear",
    "hub:jiagengliu02/edit3r",
    files=(("edit3r.ckpt", ""),),
)
OFFICIAL_RESOLUTION = 512
"""Side of the square that these weights were trained for [pixels]; the file does not tell."""
_NOPOSPLAT = Weights(
    "noposplat",
    "NoPoSplat trained on RealEstate10K, for two views of 256x256",
    2_500_000_000,
    "not stated; starts from MASt3R's weights, which are CC BY-NC-SA 4.0",
    "no",
    "hub:botaoye/NoPoSplat",
    files=(("re10k.ckpt", ""),),
)

_CITATION = (
    "Ye et al., No Pose, No Problem: Surprisingly Simple 3D Gaussian Splats from Sparse Unposed "
    "Images, ICLR 2025"
)


@hookimpl
def register_backbones():
    about = "small U-Net over photos and matched geometry"
    small = Component(
        "matched-unet", "edit3r_model.matched_unet:MatchedUNet", about, min_views=2
    )
    full = Component(
        "asymmetric-vit",
        "edit3r_model.asymmetric_vit:AsymmetricViT",
        "shared ViT encoder with intrinsics token, one decoder for view 0 and one for all other "
        "views",
        min_views=2,
        citation=_CITATION,
    )
    return (small, full)


@hookimpl
def register_heads():
    about = "carries and fuses the edits over matched geometry; goes with any backbone"
    small = Component(
        "edit-fusion",
        "edit3r_model.edit_fusion_head:EditFusionHead",
        about,
        parts=("backbone",),
        min_views=2,
    )
    full = Component(
        "dpt-gaussian",
        "edit3r_model.dpt_head:DptGaussianHead",
        "dense heads: centres from transformer features alone, attributes with an RGB shortcut",
        parts=("backbone",),
        min_views=2,
        citation=_CITATION,
    )
    return (small, full)


@hookimpl
def register_reconstructors():
    edit3r = Component(
        name="edit3r",
        target="edit3r_model.reconstructor:Edit3rReconstructor",
        summary="matched geometry, and a small network that carries and fuses the edits (weights "
        "ship); or the full network in a single pass",
        parts=("backbone", "head"),
        min_views=2,
        weights=(OFFICIAL,),
        citation="Edit3r: Instant 3D Scene Editing from Sparse Unposed Images",
    )
    noposplat = Component(
        "noposplat",
        "edit3r_model.reconstructor:NoPoSplatReconstructor",
        "full-size network by itself; reads official .ckpt, MASt3R .pth (as initialisation) or "
        "our safetensors; ships no weights",
        parts=("backbone", "head"),
        min_views=2,
        weights=(OFFICIAL, _NOPOSPLAT),
        citation=_CITATION,
    )
    return (edit3r, noposplat)
