"""Optimisation-based editing: fit 3D Gaussians to the photos, edit, fit again; what feed-forward is
compared with.
"""

from functools import partial

from edit3r import Component, hookimpl

EDIT3R_API = 1

_method = partial(
    Component, parts=("reconstructor", "editor", "rasterizer"), min_views=2
)


@hookimpl
def register_reconstructors():
    return [
        _method(
            "refit",
            "edit3r_optimisers.refit:RefitReconstructor",
            "fits Gaussians to the photos, then again to the edited photos or to edited renders; "
            "minutes, not one pass",
            citation="Kerbl et al., 3D Gaussian Splatting for Real-Time Radiance Field "
            "Rendering, SIGGRAPH 2023",
        ),
        _method(
            "instruct-nerf2nerf",
            "edit3r_optimisers.instruct_nerf2nerf:InstructNerf2NerfReconstructor",
            "iterative dataset update: while Gaussians are fitted, one view after the other is "
            "edited anew",
            citation="Haque et al., Instruct-NeRF2NeRF: Editing 3D Scenes with Instructions, "
            "ICCV 2023",
        ),
        _method(
            "gaussctrl",
            "edit3r_optimisers.gaussctrl:GaussCtrlReconstructor",
            "edits renders of all views together, aligned by attention (editor "
            "controlnet-depth), then fits again",
            citation="Wu et al., GaussCtrl: Multi-View Consistent Text-Driven 3D Gaussian "
            "Splatting Editing, ECCV 2024",
        ),
        _method(
            "editsplat",
            "edit3r_optimisers.editsplat:EditSplatReconstructor",
            "edits again from the fused edits of neighbours, trims Gaussians that the edit "
            "attends to, fits again",
            citation="Lee et al., EditSplat: Multi-View Fusion and Attention-Guided "
            "Optimization, CVPR 2025",
        ),
    ]
