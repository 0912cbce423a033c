"""The before/after sheet: per view the photo, its 2D edit and the 3D result, with captions and the prompt."""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Float
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from edit3r.io.images import to_bytes

__all__ = ["COLUMNS", "draw_before_after"]

COLUMNS = ("photo", "2D edit", "3D result")

_PAPER, _INK, _FAINT, _RULE = (250, 249, 247), (28, 28, 30), (122, 120, 116), (222, 219, 213)
_TITLE, _CAPTION = 26, 17  # text sizes [pixels]
_MARGIN, _GAP, _BLOCK_GAP = 32, 8, 28
_LONGEST_CELL = 512  # [pixels]; images are reduced to this and enlarged to half of it
_LARGEST_SHEET = 2600  # [pixels] in either direction; cells shrink for many views


@dataclass(frozen=True)
class _Layout:
    """Where the views lie; all sizes are (width, height) [pixels]."""

    cell: tuple[int, int]  # of every image
    across: int  # views beside each other
    down: int  # views below each other

    @property
    def block(self) -> tuple[int, int]:
        """Size of one view with its caption."""
        return len(COLUMNS) * (self.cell[0] + _GAP) - _GAP, self.cell[1] + _CAPTION + 12

    @property
    def body(self) -> tuple[int, int]:
        """Size of all views."""
        return self.across * (self.block[0] + _BLOCK_GAP) - _BLOCK_GAP, self.down * (
            self.block[1] + 2 * _GAP
        ) - 2 * _GAP

    def corner(self, view: int) -> tuple[int, int]:
        """Place of a view's first pixel."""
        row, column = divmod(view, self.across)
        return column * (self.block[0] + _BLOCK_GAP), row * (self.block[1] + 2 * _GAP)


def draw_before_after(
    photos: Float[Tensor, "view 3 height width"],
    edited: Float[Tensor, "view 3 height width"],
    rendered: Float[Tensor, "view 3 height width"],
    *,
    names: Sequence[str] = (),
    title: str = "",
    subtitle: str = "",
) -> Image.Image:
    """The sheet as an image: one block a view, blocks arranged so that the sheet is nearest to 3:2.

    `title` is usually the prompt, `subtitle` names editor and reconstructor.
    """
    views = len(photos)
    if not views or any(len(images) != views for images in (edited, rendered)):
        raise ValueError(f"the sheet needs as many edits and results as photos, got {len(edited)}, {len(rendered)}")
    names = names or [f"view {index}" for index in range(views)]
    layout = _layout(views, photos.shape[-2:])
    width = max(layout.body[0], 3 * _LONGEST_CELL // 2) + 2 * _MARGIN
    lines = [(line, _INK, _TITLE, 8) for line in _wrap(title, _TITLE, width - 2 * _MARGIN)]
    lines += [(line, _FAINT, _CAPTION, 7) for line in _wrap(subtitle, _CAPTION, width - 2 * _MARGIN)]
    top = _MARGIN + sum(size + gap for _, _, size, gap in lines) + (18 if lines else 0)
    sheet = Image.new("RGB", (width, top + layout.body[1] + _MARGIN), _PAPER)
    draw, below = ImageDraw.Draw(sheet), _MARGIN - 6
    for line, colour, size, gap in lines:
        draw.text((_MARGIN, below), line, colour, _font(size))
        below += size + gap
    if lines:
        draw.line([(_MARGIN, top - 12), (width - _MARGIN, top - 12)], _RULE)
    indent = (width - layout.body[0]) // 2
    for index in range(views):
        x, y = layout.corner(index)
        _draw_view(
            sheet, (indent + x, top + y), layout.cell, names[index], [i[index] for i in (photos, edited, rendered)]
        )
    return sheet


def _layout(views: int, image_size: tuple[int, int]) -> _Layout:
    height, width = image_size
    # Small images are enlarged to half a cell, so that captions fit and pixels can be seen.
    scale = min(_LONGEST_CELL, max(_LONGEST_CELL // 2, max(height, width))) / max(height, width)
    cell = (max(16, round(width * scale)), max(16, round(height * scale)))
    candidates = [_Layout(cell, across, math.ceil(views / across)) for across in range(1, views + 1)]
    best = min(candidates, key=lambda layout: abs(math.log(layout.body[0] / layout.body[1] / 1.5)))
    shrink = min(1.0, _LARGEST_SHEET / max(best.body))
    return _Layout(tuple(max(16, int(side * shrink)) for side in cell), best.across, best.down)


def _draw_view(
    sheet: Image.Image, corner: tuple[int, int], cell: tuple[int, int], name: str, images: Sequence[Tensor]
) -> None:
    """Draw the images of one view beside each other, each with its caption; the photo's name beside the first."""
    draw, font, (x, y) = ImageDraw.Draw(sheet), _font(_CAPTION), corner
    for label, image in zip(COLUMNS, images):
        sheet.paste(Image.fromarray(to_bytes(image)).resize(cell, Image.Resampling.LANCZOS), (x, y))
        draw.text((x, y + cell[1] + 4), label, _INK, font)
        x += cell[0] + _GAP
    indent = draw.textlength(f"{COLUMNS[0]}   ", font)
    if (room := _columns(name, _CAPTION, cell[0] - indent)) > 2:
        shown = name if len(name) <= room else f"{name[: room - 1]}…"
        draw.text((corner[0] + indent, y + cell[1] + 4), shown, _FAINT, font)


def _font(size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.load_default(size)  # Pillow's packaged Aileron: the same on every machine


def _columns(text: str, size: int, room: float) -> int:
    """How many characters such as those of the text fit into `room` pixels, a little to spare."""
    beginning = text[:1000] or "x"
    return int(0.95 * room * len(beginning) / max(1.0, _font(size).getlength(beginning)))


def _wrap(text: str, size: int, room: float) -> list[str]:
    """Lines of whole words, at most 3; what is left over is cut with an ellipsis."""
    return textwrap.wrap(text, max(2, _columns(text, size, room)), max_lines=3, placeholder="…")
