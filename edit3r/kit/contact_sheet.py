"""A sheet to look at: the images of each view side by side, with captions.

Such as photo, 2D edit and 3D result; and outlines of masks drawn on images.
"""

import math
import textwrap
from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Float
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from edit3r.contract.interfaces import OtherCandidates
from edit3r.contract.types import Rendering, Views
from edit3r.kit.photos.images import to_bytes

__all__ = [
    "draw_outline",
    "draw_sheet",
    "images_of",
    "outlined",
    "outlined_views",
    "with_candidates",
]

_PAPER = (250, 249, 247)
_INK = (28, 28, 30)
_FAINT = (122, 120, 116)
_RULE = (222, 219, 213)

# All lengths are in pixels.
_TITLE = 26  # text size
_CAPTION = 17  # text size
_LEADING = 8  # between lines of text
_MARGIN = 32
_GAP = 8  # between the images of a view
_BLOCK_GAP = 28  # between views
_BELOW = 45  # from an image to the next one below it, caption included
_MAX_CELL = 512  # images are reduced to this and enlarged to half of it
_MAX_SHEET = 2600  # in either direction; cells shrink for many views

Size = tuple[int, int]
"""(width, height) [pixels]."""


def images_of(views: Views | Rendering) -> Float[Tensor, "view 3 height width"]:
    """The images of the first scene, which are clipped where they are drawn or written."""
    return views.images[0].cpu()


def draw_sheet(
    columns: Mapping[str, Float[Tensor, "view 3 height width"]],
    *,
    names: Sequence[str] = (),
    title: str = "",
    subtitle: str = "",
) -> Image.Image:
    """Draw images of the same views by caption: one block a view, the sheet nearest to 3:2."""
    counts = [len(images) for images in columns.values()]
    views = counts[0]
    if not views or set(counts) != {views}:
        raise ValueError(
            f"a sheet needs as many images of each kind as views, got {counts}"
        )
    height, width = next(iter(columns.values())).shape[-2:]
    cell, across = _arranged(views, len(columns), (width, height))
    block_width, block_height = _block_size(cell, len(columns))
    rows = math.ceil(views / across)
    body_width = across * block_width - _BLOCK_GAP - _GAP
    body = Image.new("RGB", (body_width, rows * block_height - 2 * _GAP), _PAPER)
    for view in range(views):
        row, place = divmod(view, across)
        images = {caption: images[view] for caption, images in columns.items()}
        block = _draw_view(images, cell, names[view] if names else f"view {view}")
        body.paste(block, (place * block_width, row * block_height))
    head = _draw_heading(title, subtitle, max(body.width, 3 * _MAX_CELL // 2))
    size = (head.width + 2 * _MARGIN, head.height + body.height + 2 * _MARGIN)
    sheet = Image.new("RGB", size, _PAPER)
    sheet.paste(head, (_MARGIN, _MARGIN))
    sheet.paste(body, ((sheet.width - body.width) // 2, _MARGIN + head.height))
    return sheet


def with_candidates(
    sheet: Image.Image, candidates: Sequence[OtherCandidates]
) -> Image.Image:
    """The sheet with what else may be meant below it."""
    for one in candidates:
        columns = {
            caption: outlined(one.photo, mask)[None]
            for caption, mask in one.masks.items()
        }
        strip = draw_sheet(columns, names=[one.name], title="What else it may be")
        sheet = _stacked(sheet, strip)
    return sheet


def _stacked(above: Image.Image, below: Image.Image) -> Image.Image:
    """Two sheets as one, the second below the first."""
    size = (max(above.width, below.width), above.height + below.height)
    sheet = Image.new("RGB", size, _PAPER)
    sheet.paste(above, (0, 0))
    sheet.paste(below, (0, above.height))
    return sheet


def _arranged(views: int, columns: int, image: Size) -> tuple[Size, int]:
    """Size of each image on the sheet, and how many views stand beside each other."""
    # Small images are enlarged to half a cell, so that captions fit and pixels can be seen.
    longer = min(_MAX_CELL, max(_MAX_CELL // 2, *image))
    cell = _scaled(image, longer / max(image))
    width, height = _block_size(cell, columns)
    # The sheet is `across * width` wide and `views / across * height` high.
    across = round(math.sqrt(1.5 * views * height / width))
    across = min(max(across, 1), views)
    rows = math.ceil(views / across)
    scale = _MAX_SHEET / max(across * width, rows * height)
    return _scaled(cell, min(1.0, scale)), across


def _scaled(size: Size, scale: float) -> Size:
    width, height = (max(16, int(side * scale)) for side in size)
    return width, height


def _block_size(cell: Size, columns: int) -> Size:
    """What a view takes on the sheet, with captions and the room to the next view."""
    return columns * (cell[0] + _GAP) + _BLOCK_GAP, cell[1] + _BELOW


def _draw_view(images: Mapping[str, Tensor], cell: Size, name: str) -> Image.Image:
    """Draw a view's images with their captions, and the view's name beside the first caption."""
    width, height = cell
    block = Image.new("RGB", _block_size(cell, len(images)), _PAPER)
    draw = ImageDraw.Draw(block)
    font = _font(_CAPTION)
    indent = draw.textlength(f"{next(iter(images))}   ", font)
    for line in _wrap(name, _CAPTION, width - indent, max_lines=1):
        draw.text((indent, height + 4), line, _FAINT, font)
    left = 0
    for caption, image in images.items():
        shown = Image.fromarray(to_bytes(image))
        block.paste(shown.resize(cell, Image.Resampling.LANCZOS), (left, 0))
        draw.text((left, height + 4), caption, _INK, font)
        left += width + _GAP
    return block


def _draw_heading(title: str, subtitle: str, width: int) -> Image.Image:
    """Draw both texts with a line below them; nothing where both are empty."""
    lines = [(line, _INK, _TITLE) for line in _wrap(title, _TITLE, width)]
    lines += [(line, _FAINT, _CAPTION) for line in _wrap(subtitle, _CAPTION, width)]
    height = sum(size + _LEADING for _, _, size in lines)
    head = Image.new("RGB", (width, height + 18 if lines else 0), _PAPER)
    draw = ImageDraw.Draw(head)
    draw.line([(0, height + 6), (width, height + 6)], _RULE)
    top = -6
    for line, colour, size in lines:
        draw.text((0, top), line, colour, _font(size))
        top += size + _LEADING
    return head


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    # Pillow's packaged Aileron: the same on every machine.
    return ImageFont.load_default(size)


def _wrap(text: str, size: int, room: float, max_lines: int = 3) -> list[str]:
    """Lines of whole words in `room` pixels; what is left over is cut with an ellipsis."""
    beginning = text[:1000] or "x"
    per_character = max(1.0, _font(size).getlength(beginning)) / len(beginning)
    fitting = max(2, int(0.95 * room / per_character))
    return textwrap.wrap(text, fitting, max_lines=max_lines, placeholder="…")


INSIDE, AROUND = 255, 0
"""A white line in a black one is seen on every photo."""


def outlined(
    image: Float[Tensor, "3 height width"], mask: Float[Tensor, "height width"]
) -> Float[Tensor, "3 height width"]:
    """The image with the outline of what is above 0.5 in the mask."""
    pixels = (image.movedim(0, -1).clamp(0, 1) * 255).round().byte().cpu().numpy()
    pixels = np.ascontiguousarray(pixels)
    draw_outline(pixels, (mask > 0.5).cpu().numpy())
    return torch.from_numpy(pixels).movedim(-1, 0).to(image) / 255


def draw_outline(pixels: np.ndarray, inside: np.ndarray) -> None:
    """Draw the outline of a mask of booleans into bytes: [height, width, 3] of RGB, or
    [height, width, 2] of grey and opacity.
    """
    mask = inside.astype(np.uint8)
    contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    width = max(1, round(max(inside.shape) / 400))  # [pixels]
    for shade, times in ((AROUND, 3), (INSIDE, 1)):
        colour = (shade, 255) if pixels.shape[-1] == 2 else (shade,) * 3
        cv2.drawContours(pixels, contours, -1, colour, times * width, cv2.LINE_AA)


def outlined_views(
    images: Float[Tensor, "view 3 height width"],
    masks: Float[Tensor, "view height width"] | None,
) -> Float[Tensor, "view 3 height width"]:
    """The images with the outlines of their masks, where there are any."""
    if masks is None:
        return images
    return torch.stack([outlined(*pair) for pair in zip(images, masks)])
