"""The before/after sheet: per view the photo, its 2D edit and the 3D result, with captions and the prompt."""

import bisect
import math
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
    cell: tuple[int, int]  # (width, height) of every image
    columns: int  # images of one view beside each other
    across: int  # views beside each other
    down: int  # views below each other

    @property
    def block(self) -> tuple[int, int]:
        """(width, height) of one view with its caption."""
        width = self.columns * self.cell[0] + (self.columns - 1) * _GAP
        return width, self.cell[1] + _CAPTION + 12

    @property
    def body(self) -> tuple[int, int]:
        width = self.across * self.block[0] + (self.across - 1) * _BLOCK_GAP
        return width, self.down * self.block[1] + (self.down - 1) * _GAP * 2


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
    heading = _wrap(title, _font(_TITLE), width - 2 * _MARGIN)
    notes = _wrap(subtitle, _font(_CAPTION), width - 2 * _MARGIN)
    top = _MARGIN + len(heading) * (_TITLE + 8) + len(notes) * (_CAPTION + 7) + (18 if heading or notes else 0)
    sheet = Image.new("RGB", (width, top + layout.body[1] + _MARGIN), _PAPER)
    _draw_text(ImageDraw.Draw(sheet), heading, notes, top, width)
    indent = (width - layout.body[0]) // 2
    for index in range(views):
        row, column = divmod(index, layout.across)
        x = indent + column * (layout.block[0] + _BLOCK_GAP)
        y = top + row * (layout.block[1] + 2 * _GAP)
        _draw_view(sheet, (x, y), layout, names[index], (photos[index], edited[index], rendered[index]))
    return sheet


def _layout(views: int, image_size: tuple[int, int]) -> _Layout:
    height, width = image_size
    # Small images are enlarged to half a cell, so that captions fit and pixels can be seen.
    scale = min(_LONGEST_CELL, max(_LONGEST_CELL // 2, max(height, width))) / max(height, width)
    cell = (max(16, round(width * scale)), max(16, round(height * scale)))
    candidates = [_Layout(cell, len(COLUMNS), across, math.ceil(views / across)) for across in range(1, views + 1)]
    # A gap in the last row counts like a bad shape: prefer full grids.
    best = min(
        candidates,
        key=lambda c: abs(math.log(c.body[0] / c.body[1] / 1.5)) + 0.3 * (c.across * c.down - views) / c.across,
    )
    shrink = min(1.0, _LARGEST_SHEET / max(best.body))
    return _Layout(tuple(max(16, int(side * shrink)) for side in cell), best.columns, best.across, best.down)


def _draw_text(draw: ImageDraw.ImageDraw, heading: list[str], notes: list[str], top: int, width: int) -> None:
    y = _MARGIN - 6
    for line in heading:
        draw.text((_MARGIN, y), line, _INK, _font(_TITLE))
        y += _TITLE + 8
    for line in notes:
        draw.text((_MARGIN, y), line, _FAINT, _font(_CAPTION))
        y += _CAPTION + 7
    if heading or notes:
        draw.line([(_MARGIN, top - 12), (width - _MARGIN, top - 12)], _RULE)


def _draw_view(
    sheet: Image.Image, corner: tuple[int, int], layout: _Layout, name: str, images: tuple[Tensor, Tensor, Tensor]
) -> None:
    draw = ImageDraw.Draw(sheet)
    font = _font(_CAPTION)
    for column, (label, image) in enumerate(zip(COLUMNS, images)):
        x, y = corner[0] + column * (layout.cell[0] + _GAP), corner[1]
        sheet.paste(Image.fromarray(to_bytes(image)).resize(layout.cell, Image.Resampling.LANCZOS), (x, y))
        below = y + layout.cell[1] + 4
        room = layout.cell[0]
        draw.text((x, below), label, _INK, font)
        if column == 0:
            start = draw.textlength(label + "   ", font)
            draw.text((x + start, below), _shorten(name, font, room - start), _FAINT, font)


def _font(size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.load_default(size)  # Pillow's packaged Aileron: the same on every machine


def _shorten(text: str, font: ImageFont.FreeTypeFont, room: float) -> str:
    """The text, cut with an ellipsis to fit `room` pixels; empty when nothing readable fits."""
    if font.getlength(text) <= room:
        return text
    end = bisect.bisect(range(len(text)), room, key=lambda end: font.getlength(text[:end] + "…")) - 1
    return text[:end] + "…" if end > 2 else ""


def _wrap(text: str, font: ImageFont.FreeTypeFont, room: int) -> list[str]:
    """Lines of whole words, at most 3; a word too long for a line, and what is left over, is shortened."""
    lines: list[str] = []
    for word in text.split():
        if lines and font.getlength(f"{lines[-1]} {word}") <= room:
            lines[-1] += f" {word}"
        elif len(lines) == 3:
            lines[-1] = _shorten(f"{lines[-1]} {word}", font, room)
            break
        else:
            lines.append(_shorten(word, font, room))
    return lines
