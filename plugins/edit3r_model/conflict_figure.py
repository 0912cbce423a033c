"""The figure behind the paper's figure 5, of any run: what each view's Gaussians show, and where they give way.

One row a view: its photo, its 2D edit, a rendering of its own Gaussians alone, how opaque these are, and where its edit
contradicts the reference's; the last row is the whole scene.
"""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from edit3r.earlier_run import EarlierRun
from edit3r.geometry.harmonics import colour_to_dc
from edit3r.geometry.warping import find_correspondences
from edit3r.interfaces import Rasterizer
from edit3r.io.images import save_pixels, to_bytes
from edit3r.rendering import render_each
from edit3r.types import Gaussians, Rendering
from edit3r_model.edit_colour import edits_disagree, near_an_edit

COLUMNS = ("photo", "2D edit", "its Gaussians alone", "their opacity", "edit contradicts view 0's")
_CELL, _GAP, _CAPTION = 256, 6, 20  # longest side of a picture, between pictures, height of a line [pixels]


@torch.no_grad()
def save_conflict_figure(path: str | Path, run: EarlierRun, rasterizer: Rasterizer) -> list[tuple[float, float]]:
    """Write the figure as PNG; return for each view the mean opacity of its Gaussians inside and outside conflicts."""
    cameras, gaussians, views = run.scene.cameras, run.scene.gaussians, run.photos.count
    whole = render_each(rasterizer, gaussians, cameras, "scene")
    conflict = _conflict(run, whole)
    rows, figures = [], []
    for view in range(views):
        own = gaussians.from_view(view)
        alone = rasterizer.render(own, cameras.select([view])).images[0, 0]
        opacity = _opacity(own, rasterizer.render(_showing_opacity(own), cameras.select([view])))
        inside = conflict[0, view] > 0.5
        figures.append(tuple(float(opacity[where].mean()) for where in (inside, ~inside)))  # the mean of none is NaN
        grey = (opacity.expand(3, -1, -1), conflict[0, view].expand(3, -1, -1))
        rows.append((run.photos.images[0, view], run.edited.images[0, view], alone, *grey))
    rows.append(tuple(whole.images[0, : len(COLUMNS)]))
    save_pixels(_grid(rows, run.photos.names), path)
    return figures


def _conflict(run: EarlierRun, whole: Rendering) -> Float[Tensor, "1 view height width"]:
    """Where the edits disagree, matched by the depths that the whole scene shows."""
    photos, edited, cameras = run.photos.images, run.edited.images, run.scene.cameras
    matches = find_correspondences(whole.depths[:, :, 0].clamp(min=1e-6), cameras.intrinsics, cameras.c2w)
    near = near_an_edit(edited, photos, matches, whole.alphas[:, :, 0] > 0.5)
    return near * edits_disagree(edited, photos, matches) * matches.inside


def _showing_opacity(gaussians: Gaussians) -> Gaussians:
    """The Gaussians in the grey of their own opacity."""
    grey = colour_to_dc(gaussians.opacities[..., None, None].expand(-1, -1, 1, 3))
    return Gaussians(**{**vars(gaussians), "harmonics": grey})


def _opacity(gaussians: Gaussians, grey: Rendering) -> Float[Tensor, "height width"]:
    """Mean opacity of the Gaussians that each pixel shows, weighted as they show."""
    return (grey.images[0, 0, 0] / grey.alphas[0, 0, 0].clamp(min=1e-3)).clamp(0, 1)


def _grid(rows: list[tuple[Tensor, ...]], names: tuple[str, ...]) -> np.ndarray:
    """All pictures on one sheet, a caption below each."""
    height, width = rows[0][0].shape[-2:]
    scale = _CELL / max(height, width)
    size = (round(width * scale), round(height * scale))
    step = (size[0] + _GAP, size[1] + _CAPTION + _GAP)
    sheet = Image.new("RGB", (len(COLUMNS) * step[0] + _GAP, len(rows) * step[1] + _GAP), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(13)
    for index, row in enumerate(rows):
        last = index == len(rows) - 1
        for column, image in enumerate(row):
            corner = _GAP + column * step[0], _GAP + index * step[1]
            sheet.paste(Image.fromarray(to_bytes(image)).resize(size, Image.Resampling.LANCZOS), corner)
            text = f"whole scene, {names[column]}" if last else f"{names[index]}: {COLUMNS[column]}"
            draw.text((corner[0], corner[1] + size[1] + 2), text, "black", font)
    return np.asarray(sheet)
