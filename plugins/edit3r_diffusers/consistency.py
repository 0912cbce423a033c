"""Ways to make the edits of several views agree, and how much they disagree."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import SettingsError
from edit3r.contract.reporting import note
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.photos.images import to_bytes

Consistency = Literal["independent", "reference-first", "grid"]
References = tuple[Float[Tensor, "3 height width"], ...]
Edit = Callable[[Views, EditRequest, References], Views]
"""Edits every view by itself, beside pictures that it may look at."""

FOLLOW = (
    "{prompt}. The second picture shows the same scene from elsewhere and the third is the "
    "second after this edit: "
    "edit the first picture in the same way."
)
FEWEST_MATCHES = 12
PATCH = 5  # pixels that colours are averaged over, so that a match may be off by one


def edit_consistently(
    mode: Consistency, several: bool, edit: Edit, views: Views, request: EditRequest
) -> Views:
    """Edit views by `edit` in one of the ways; notes in the run how much the edits disagree.

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
        edited = edit(views, request, ())
    else:
        scenes = [
            ways[mode](edit, views.scene(at), request.of_scene(at))
            for at in range(len(views.images))
        ]
        edited = replace(views, images=torch.cat(scenes))
    found = [disagreement(*pair) for pair in zip(views.images, edited.images)]
    measured = [value for value in found if value is not None]
    outcome: object = f"not measured: fewer than {FEWEST_MATCHES} matches"
    if measured:
        outcome = round(float(np.mean(measured)), 4)
    note("editor.consistency", {"mode": mode, "disagreement": outcome})
    return edited


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


def disagreement(
    photos: Float[Tensor, "view 3 height width"],
    edited: Float[Tensor, "view 3 height width"],
) -> float | None:
    """How differently the edits changed what view 0 and another view both show [sRGB]; 0: alike.

    The same spots are found by SIFT matches between the unedited photos that agree with one
    epipolar geometry (MAGSAC), so a wrong edit cannot hide in them; there, the two changes of
    colour are compared (mean absolute difference over matches, channels and views). None where too
    few spots are found.
    """
    change = (edited - photos).detach().float().cpu().permute(0, 2, 3, 1).numpy()
    grey = [cv2.cvtColor(to_bytes(photo), cv2.COLOR_RGB2GRAY) for photo in photos]
    smooth = [cv2.blur(np.ascontiguousarray(image), (PATCH, PATCH)) for image in change]
    sift = cv2.SIFT.create()
    points, described = zip(*(sift.detectAndCompute(image, None) for image in grey))
    differences = []
    for other in range(1, len(photos)):
        spots = _matched(points[0], described[0], points[other], described[other])
        if len(spots) >= FEWEST_MATCHES:
            (x, y), (x2, y2) = spots.round().astype(int).transpose(1, 2, 0)
            differences.append(np.abs(smooth[0][y, x] - smooth[other][y2, x2]).mean())
    return float(np.mean(differences)) if differences else None


def _matched(
    points0, described0, points1, described1
) -> Float[np.ndarray, "match 2 2"]:
    """Pixels of mutual nearest descriptors on one fundamental matrix; empty where few are."""
    if described0 is None or described1 is None:
        return np.zeros((0, 2, 2))
    matches = cv2.BFMatcher(crossCheck=True).match(described0, described1)
    pairs = [(points0[m.queryIdx].pt, points1[m.trainIdx].pt) for m in matches]
    spots = np.array(pairs).reshape(-1, 2, 2)
    if len(spots) < FEWEST_MATCHES:
        return spots
    try:
        _, kept = cv2.findFundamentalMat(
            spots[:, 0], spots[:, 1], cv2.USAC_MAGSAC, 1.0, 0.999, 10_000
        )
    except cv2.error:  # matches of which no geometry can be computed
        kept = None
    return spots[kept.ravel().astype(bool)] if kept is not None else spots[:0]
