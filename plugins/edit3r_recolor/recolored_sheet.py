"""One picture that shows a recoloured set: a row a view of photo, regions, result and augmented result."""

import colorsys
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from PIL import Image, ImageDraw
from torch import Tensor

from edit3r.io.images import save_pixels, to_bytes

MOST_ROWS = 12
CELL = 320
"""Longer side of a picture on the sheet [pixels]."""

Images = Float[Tensor, "view 3 height width"]


def save_sheet(
    path: Path,
    photos: Images,
    masks: Float[Tensor, "object view height width"],
    images: Images,
    augmented: Images | None,
    names: list[str],
) -> None:
    """Write the sheet; of many views an even choice is shown."""
    rows = sorted({int(v) for v in np.linspace(0, len(photos) - 1, min(MOST_ROWS, len(photos)))})
    columns = [photos, _painted(photos, masks), images] + ([] if augmented is None else [augmented])
    lines = [torch.cat([_cell(column[row]) for column in columns], -1) for row in rows]
    sheet = Image.fromarray(to_bytes(torch.cat(lines, -2)))
    draw = ImageDraw.Draw(sheet)
    for index, row in enumerate(rows):
        place = (4, index * lines[0].shape[-2] + 4)
        draw.rectangle(draw.textbbox(place, names[row]), fill=(0, 0, 0))
        draw.text(place, names[row], fill=(255, 255, 255))
    save_pixels(np.asarray(sheet), path)


def _painted(photos: Images, masks: Float[Tensor, "object view height width"]) -> Images:
    """Grey photos with every region in a colour of its own, the same in all views."""
    shown = 0.6 * photos.mean(1, keepdim=True).expand(-1, 3, -1, -1)
    for number, mask in enumerate(masks):
        colour = shown.new_tensor(colorsys.hsv_to_rgb((number * 0.381966) % 1, 0.8, 1.0))  # golden ratio: far apart
        shown = torch.lerp(shown, colour[:, None, None].expand_as(shown), 0.6 * mask[:, None])
    return shown


def _cell(image: Float[Tensor, "3 height width"]) -> Float[Tensor, "3 h w"]:
    factor = min(1.0, CELL / max(image.shape[-2:]))
    return F.interpolate(image[None], scale_factor=factor, mode="area")[0] if factor < 1 else image
