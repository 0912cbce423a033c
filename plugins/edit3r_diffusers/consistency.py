"""Ways to make the edits of several views agree."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import SettingsError
from edit3r.contract.types import EditRequest, Views

Consistency = Literal["independent", "reference-first", "grid"]
References = tuple[Float[Tensor, "3 height width"], ...]
Edit = Callable[[Views, EditRequest, References], Views]
"""Edits every view by itself, beside pictures that it may look at."""

FOLLOW = (
    "{prompt}. The second picture shows the same scene from elsewhere and the third is the "
    "second after this edit: "
    "edit the first picture in the same way."
)


def edit_consistently(
    mode: Consistency, several: bool, edit: Edit, views: Views, request: EditRequest
) -> Views:
    """Edit views by `edit` in one of the ways.

    `several`: whether the model looks at further pictures, which reference-first needs
    (SettingsError).
    """
    if mode == "reference-first" and not several:
        raise SettingsError(
            "editor.consistency: this pipeline takes one picture, and reference-first needs one "
            "that takes several (flux2-klein, qwen-image-edit); use grid, which works with any."
        )
    ways = {"reference-first": _reference_first, "grid": _grid}
    if mode == "independent" or views.count < 2:
        return edit(views, request, ())
    scenes = [
        ways[mode](edit, views.scene(at), request.of_scene(at))
        for at in range(len(views.images))
    ]
    return replace(views, images=torch.cat(scenes))


def _reference_first(
    edit: Edit, views: Views, request: EditRequest
) -> Float[Tensor, "1 view 3 height width"]:
    """Edit view 0, then each other one given [its photo, photo 0, edited 0]."""
    first = edit(views.select([0]), request.of_views([0]), ()).images
    rest = range(1, views.count)
    prompt = FOLLOW.format(prompt=request.prompt.rstrip(". "))
    follow = replace(request.of_views(rest), prompt=prompt)
    others = edit(views.select(rest), follow, (views.images[0, 0], first[0, 0]))
    return torch.cat((first, others.images), dim=1)


def _grid(
    edit: Edit, views: Views, request: EditRequest
) -> Float[Tensor, "1 view 3 height width"]:
    """Edit all views as one picture (as RL3DEdit does); empty cells repeat the last view."""
    columns = math.ceil(math.sqrt(views.count))
    rows = math.ceil(views.count / columns)
    cells = [min(cell, views.count - 1) for cell in range(rows * columns)]

    def laid(images: Float[Tensor, "view c h w"]) -> Float[Tensor, "1 1 c H W"]:
        grid = images[cells].unflatten(0, (rows, columns)).permute(2, 0, 3, 1, 4)
        return grid.flatten(3, 4).flatten(1, 2)[None, None]

    canvas = Views(laid(views.images[0]), views.intrinsics[:, :1], ("all views",))
    masks = None if request.masks is None else laid(request.masks[0][:, None])[:, :, 0]
    edited = edit(canvas, replace(request, masks=masks), ()).images[0, 0]
    height, width = views.image_size
    apart = edited.unflatten(1, (rows, height)).unflatten(3, (columns, width))
    return apart.permute(1, 3, 0, 2, 4).flatten(0, 1)[None, : views.count]
