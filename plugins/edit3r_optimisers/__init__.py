"""Optimisation-based editing: fit 3D Gaussians to the photos, edit, fit again; what feed-forward is compared with."""

from edit3r import Component, hookimpl

EDIT3R_API = 1

_PARTS = ("reconstructor", "editor", "rasterizer")


@hookimpl
def register_reconstructors():
    return [
        Component(
            "refit",
            "edit3r_optimisers.refit:RefitReconstructor",
            "fits Gaussians to the photos, then again to the edited photos or to edited renders; minutes, not one pass",
            parts=_PARTS,
            min_views=2,
            citation="Kerbl et al., 3D Gaussian Splatting for Real-Time Radiance Field Rendering, SIGGRAPH 2023",
        ),
        Component(
            "instruct-nerf2nerf",
            "edit3r_optimisers.instruct_nerf2nerf:InstructNerf2NerfReconstructor",
            "iterative dataset update: while Gaussians are fitted, one view after the other is edited anew",
            parts=_PARTS,
            min_views=2,
            citation="Haque et al., Instruct-NeRF2NeRF: Editing 3D Scenes with Instructions, ICCV 2023",
        ),
        Component(
            "gaussctrl",
            "edit3r_optimisers.gaussctrl:GaussCtrlReconstructor",
            "edits renders of all views together, aligned by attention (editor controlnet-depth), then fits again",
            parts=_PARTS,
            min_views=2,
            citation="Wu et al., GaussCtrl: Multi-View Consistent Text-Driven 3D Gaussian Splatting Editing, ECCV 2024",
        ),
        Component(
            "editsplat",
            "edit3r_optimisers.editsplat:EditSplatReconstructor",
            "edits again from the fused edits of neighbours, trims Gaussians that the edit attends to, fits again",
            parts=_PARTS,
            min_views=2,
            citation="Lee et al., EditSplat: Multi-View Fusion and Attention-Guided Optimization, CVPR 2025",
        ),
    ]
