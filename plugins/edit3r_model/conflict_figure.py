"""The figure behind the paper's figure 5, of any run: what each view's Gaussians show, and where
they give way.

Of each view: its photo, its 2D edit, a rendering of its own Gaussians alone, how opaque these are,
where its edit contradicts the reference's, and the whole scene.
"""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Gaussians, Rendering
from edit3r.geometry.harmonics import colour_to_dc
from edit3r.geometry.warping import find_correspondences
from edit3r.io.images import save_pixels
from edit3r.io.sheet import draw_sheet
from edit3r.pipeline.earlier import EarlierRun
from edit3r.pipeline.rendering import render_each
from edit3r_model.edit_colour import (
    edits_disagree,
    looks_of,
    near_an_edit,
    shown_by_views,
)


@torch.no_grad()
def save_conflict_figure(
    path: str | Path, run: EarlierRun, rasterizer: Rasterizer
) -> list[tuple[float, float]]:
    """Write the figure as PNG; return for each view the mean opacity of its Gaussians inside and
    outside conflicts.
    """
    cameras, gaussians, views = run.scene.cameras, run.scene.gaussians, run.photos.count
    whole = render_each(rasterizer, gaussians, cameras, "scene")
    conflict = _conflict(run, whole)
    shown, figures = [], []
    for view in range(views):
        own = gaussians.from_view(view)
        alone = rasterizer.render(own, cameras.select([view])).images[0, 0]
        opacity = _opacity(
            own, rasterizer.render(_showing_opacity(own), cameras.select([view]))
        )
        inside = conflict[0, view] > 0.5
        figures.append(
            tuple(float(opacity[where].mean()) for where in (inside, ~inside))
        )  # the mean of none is NaN
        shown.append(
            torch.stack(
                (alone, opacity.expand(3, -1, -1), conflict[0, view].expand(3, -1, -1))
            )
        )
    columns = {"photo": run.photos.images[0], "2D edit": run.edited.images[0]}
    captions = ("its Gaussians alone", "their opacity", "edit contradicts view 0's")
    columns |= dict(zip(captions, torch.stack(shown, 1))) | {
        "whole scene": whole.images[0]
    }
    save_pixels(np.asarray(draw_sheet(columns, names=run.photos.names)), path)
    return figures


def _conflict(
    run: EarlierRun, whole: Rendering
) -> Float[Tensor, "1 view height width"]:
    """Where the edits disagree, matched by the depths that the whole scene shows."""
    photos, edited, cameras = run.photos.images, run.edited.images, run.scene.cameras
    matches = find_correspondences(
        whole.depths[:, :, 0].clamp(min=1e-6), cameras.intrinsics, cameras.c2w
    )
    seen = whole.alphas[:, :, 0] > 0.5
    reference = shown_by_views(edited, photos, looks_of(photos, matches, seen))
    near = near_an_edit(edited, photos, reference, matches, seen)
    return near * edits_disagree(edited, photos, reference, matches) * matches.inside


def _showing_opacity(gaussians: Gaussians) -> Gaussians:
    """The Gaussians in the grey of their own opacity."""
    grey = colour_to_dc(gaussians.opacities[..., None, None].expand(-1, -1, 1, 3))
    return Gaussians(**{**vars(gaussians), "harmonics": grey})


def _opacity(gaussians: Gaussians, grey: Rendering) -> Float[Tensor, "height width"]:
    """Mean opacity of the Gaussians that each pixel shows, weighted as they show."""
    return (grey.images[0, 0, 0] / grey.alphas[0, 0, 0].clamp(min=1e-3)).clamp(0, 1)
