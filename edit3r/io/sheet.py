"""A sheet to look at: of each view its images side by side, such as photo, 2D edit and 3D result,
with captions.
"""

import math
import textwrap
from collections.abc import Mapping, Sequence

from jaxtyping import Float
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from edit3r.io.images import to_bytes

__all__ = ["draw_sheet"]

_PAPER, _INK, _FAINT, _RULE = (
    (250, 249, 247),
    (28, 28, 30),
    (122, 120, 116),
    (222, 219, 213),
)
_TITLE, _CAPTION = 26, 17  # text sizes [pixels]
_MARGIN, _GAP, _BLOCK_GAP, _BELOW = (
    32,
    8,
    28,
    45,
)  # _BELOW: from an image to the next one below it, caption included
_LONGEST_CELL = 512  # [pixels]; images are reduced to this and enlarged to half of it
_LARGEST_SHEET = 2600  # [pixels] in either direction; cells shrink for many views


def draw_sheet(
    columns: Mapping[str, Float[Tensor, "view 3 height width"]],
    *,
    names: Sequence[str] = (),
    title: str = "",
    subtitle: str = "",
) -> Image.Image:
    """Draw images of the same views by caption: one block a view, arranged so that the sheet is
    nearest to 3:2.
    """
    images = list(columns.values())
    views = len(images[0])
    if not views or any(len(others) != views for others in images):
        raise ValueError(
            f"a sheet needs as many images of each kind as views, got {[len(i) for i in images]}"
        )
    cell, across = _arranged(views, len(columns), images[0].shape[-2:])
    body = _extent(views, len(columns), cell, across)
    width = max(body[0], 3 * _LONGEST_CELL // 2) + 2 * _MARGIN
    lines = [
        (line, _INK, _TITLE, 8) for line in _wrap(title, _TITLE, width - 2 * _MARGIN)
    ]
    lines += [
        (line, _FAINT, _CAPTION, 7)
        for line in _wrap(subtitle, _CAPTION, width - 2 * _MARGIN)
    ]
    top = _MARGIN + sum(size + gap for _, _, size, gap in lines) + (18 if lines else 0)
    sheet = Image.new("RGB", (width, top + body[1] + _MARGIN), _PAPER)
    draw, below = ImageDraw.Draw(sheet), _MARGIN - 6
    for line, colour, size, gap in lines:
        draw.text((_MARGIN, below), line, colour, _font(size))
        below += size + gap
    if lines:
        draw.line([(_MARGIN, top - 12), (width - _MARGIN, top - 12)], _RULE)
    block = _extent(1, len(columns), cell, 1)[0] + _BLOCK_GAP
    for view in range(views):
        row, place = divmod(view, across)
        corner = (
            (width - body[0]) // 2 + place * block,
            top + row * (cell[1] + _BELOW),
        )
        captions = {caption: each[view] for caption, each in columns.items()}
        _draw_view(
            sheet, corner, cell, names[view] if names else f"view {view}", captions
        )
    return sheet


def _extent(
    views: int, columns: int, cell: tuple[int, int], across: int
) -> tuple[int, int]:
    """(width, height) of all views, `across` of them beside each other [pixels]."""
    block = columns * (cell[0] + _GAP) - _GAP
    return across * (block + _BLOCK_GAP) - _BLOCK_GAP, math.ceil(views / across) * (
        cell[1] + _BELOW
    ) - 2 * _GAP


def _arranged(
    views: int, columns: int, image_size: tuple[int, int]
) -> tuple[tuple[int, int], int]:
    """(width, height) of each image [pixels], and how many views stand beside each other."""
    height, width = image_size
    # Small images are enlarged to half a cell, so that captions fit and pixels can be seen.
    scale = min(_LONGEST_CELL, max(_LONGEST_CELL // 2, max(height, width))) / max(
        height, width
    )
    cell = (max(16, round(width * scale)), max(16, round(height * scale)))
    extents = {
        across: _extent(views, columns, cell, across) for across in range(1, views + 1)
    }
    across = min(
        extents,
        key=lambda across: abs(math.log(extents[across][0] / extents[across][1] / 1.5)),
    )
    shrink = min(1.0, _LARGEST_SHEET / max(extents[across]))
    return (max(16, int(cell[0] * shrink)), max(16, int(cell[1] * shrink))), across


def _draw_view(
    sheet: Image.Image,
    corner: tuple[int, int],
    cell: tuple[int, int],
    name: str,
    images: Mapping[str, Tensor],
) -> None:
    """Draw the images of one view beside each other, each with its caption; the view's name beside
    the first.
    """
    draw, font, (x, y) = ImageDraw.Draw(sheet), _font(_CAPTION), corner
    for caption, image in images.items():
        sheet.paste(
            Image.fromarray(to_bytes(image)).resize(cell, Image.Resampling.LANCZOS),
            (x, y),
        )
        draw.text((x, y + cell[1] + 4), caption, _INK, font)
        x += cell[0] + _GAP
    indent = draw.textlength(f"{next(iter(images))}   ", font)
    if (room := _columns(name, _CAPTION, cell[0] - indent)) > 2:
        shown = name if len(name) <= room else f"{name[: room - 1]}…"
        draw.text((corner[0] + indent, y + cell[1] + 4), shown, _FAINT, font)


def _font(size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.load_default(
        size
    )  # Pillow's packaged Aileron: the same on every machine


def _columns(text: str, size: int, room: float) -> int:
    """How many characters such as those of the text fit into `room` pixels, a little to spare."""
    beginning = text[:1000] or "x"
    return int(
        0.95 * room * len(beginning) / max(1.0, _font(size).getlength(beginning))
    )


def _wrap(text: str, size: int, room: float) -> list[str]:
    """Lines of whole words, at most 3; what is left over is cut with an ellipsis."""
    return textwrap.wrap(
        text, max(2, _columns(text, size, room)), max_lines=3, placeholder="…"
    )
