"""What can be measured of an edit without knowing what was meant: figures for the verdict on it."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import permutations

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.instructions import Change, Instruction
from edit3r.contract.interfaces import EditToJudge, Selected
from edit3r.contract.types import Cameras
from edit3r.kit.compute.changes import change_uptake
from edit3r.kit.compute.colour import rgb_to_lab
from edit3r.kit.geometry.maps import size_of
from edit3r.kit.geometry.warping import shared_surface, warp
from edit3r_judge.edit_verdict import (
    MIN_CHANGED,
    MIN_SHARE,
    EditMeasures,
)

SIDE = 256  # pixels of the longer side at which signs are read, for which limits hold
VISIBLE = 8 / 255  # change of a channel that one sees
UNCHANGED = 0.01  # share of what may change below which a picture came back as it was
REACH = 3  # pixels between an outline and the edge that it follows
MAX_CHANCE = 0.85  # share of a photo near edges, above which an outline tells nothing
EDGE = 6.0  # difference of colours across an edge [CIE Lab, over two pixels]
CLEAR_CHANGE = 24 / 255  # change of a channel from which its lack is a patch
ARRIVED = 0.4  # share of a pixel's change below which the 3D scene does not show it
PATCH_BLUR = 2.0  # pixels over which that share is taken: scenes are softer than photos
LEAST_CHANGED = 50  # pixels below which no patch is measured
NEAR = 4.0  # pixels about an outline whose colours are compared
CLEARLY = 12.0  # change of a colour from which a thing took it [CIE Lab]
OTHER_COLOUR = (
    25.0  # difference of chroma that no light makes on one material [CIE Lab]
)
PLAIN = 0.6  # steps of colour over those around, below which a place has no texture
SAME_COLOURS = 5.0  # difference of mean colours below which they are alike [CIE Lab]
SAME_SURFACE = (
    0.05  # relative difference in depth within which two views show one surface
)
HUE_TOLERANCE = 25.0  # degrees
LARGE = 0.08  # share of a photo from which a part of a thing may be the thing
IS_PART = 0.9  # share of a reading that another one holds, from which it is a part
PART_COLOUR = 8.0  # difference of colours between a part and the rest [CIE Lab]
GREY = 8.0  # chroma below which a colour is grey [CIE Lab]

Masks = Float[Tensor, "view height width"]


def measure_edit(scene: EditToJudge) -> EditMeasures:
    """Return the figures of the 2D edit; of several scenes the first counts."""
    instructions, views = scene.instructions, list(scene.edited)
    before = _small(scene.before.images[0, views])
    after = _small(scene.after.images[0, views])
    visibly = (after - before).abs().amax(1) > VISIBLE
    regions = None
    if scene.regions is not None:
        regions = _small(scene.regions[:, 0, views])
    reached = _reached(before, after, visibly, instructions, regions)
    names = [scene.before.called[view] for view in views]
    if scene.masks is None:
        shares = (1.0,) * len(before)
        faults = _unchanged(visibly, torch.ones_like(visibly), names)
        changed = float(visibly.double().mean())
        return EditMeasures(shares, changed, faults, reached=reached)
    masks = _small(scene.masks[0, views])
    inside = masks > 0.5
    shares = tuple(inside.double().mean((1, 2)).tolist())
    changed = float((visibly & inside).sum() / inside.sum().clamp(min=1))
    faults = _unchanged(visibly, inside, names)
    measures = EditMeasures(shares, changed, faults, reached=reached)
    if _means_one_clicked_thing(scene, instructions):
        measures = replace(measures, clicked=max(shares), pieces=pieces(masks))
    part, reading = likely_part(scene.before.images[0], scene.selected)
    measures = replace(measures, part=part, part_reading=reading)
    if any(
        instruction.action == "remove" for instruction in instructions
    ):  # its shadow and rim go with it
        return replace(
            measures,
            ghost=ghost_of(before, after, masks),
            made_up=made_up(before, after, masks),
        )
    if scene.selected and all("region" in one.how for one in scene.selected):
        return measures  # the left half of a picture ends on no edge
    return replace(
        measures,
        outline=outline_on_edges(before, masks),
        open_outline=open_outline(before, masks),
        taken=taken(before, after, masks, _asked_for(instructions))
        if _gives_one_colour(instructions)
        else None,
    )


def _unchanged(
    visibly: Bool[Tensor, "view height width"],
    inside: Bool[Tensor, "view height width"],
    names: Sequence[str],
) -> tuple[str, ...]:
    """That pictures came back as they were, where others did not."""
    areas = inside.double().mean((1, 2))
    changed = (visibly & inside).double().mean((1, 2)) / areas.clamp(min=1e-9)
    if float(changed.amax()) < MIN_CHANGED:
        return ()  # told of all of them
    same = (areas > MIN_SHARE) & (changed < UNCHANGED)
    return tuple(
        f"the edit of {name} is its photo, unchanged"
        for name, it_is in zip(names, same.tolist())
        if it_is
    )


def _means_one_clicked_thing(
    scene: EditToJudge, instructions: Sequence[Instruction]
) -> bool:
    """Whether a mark alone says what is meant: no name, no mask of the user's own, not all else."""
    how = {way for one in scene.selected for way in one.how}
    return "marked" in how and all(
        instruction.thing.scope == "marked" and not instruction.thing.name
        for instruction in instructions
    )


def _gives_one_colour(instructions: Sequence[Instruction]) -> bool:
    """Whether all instructions paint a thing, and all of it: no background, nothing spared."""
    kinds = {
        change.kind for instruction in instructions for change in instruction.changes
    }
    things = [
        instruction.thing for instruction in instructions if not instruction.without
    ]
    return (
        kinds == {"paint"}
        and len(things) == len(instructions)
        and all(one.scope in ("named", "marked") and one.part is None for one in things)
    )


def _asked_for(instructions: Sequence[Instruction]) -> Float[Tensor, "colour 3"]:
    """The colours that instructions paint in, which may be read off other things."""
    changes = [change for instruction in instructions for change in instruction.changes]
    return torch.tensor([one.colour.rgb for one in changes if one.colour]).view(-1, 3)


def pieces(masks: Masks) -> float:
    """Share of a mask that does not belong to its largest piece; the largest over the views."""
    apart = [0.0]
    for mask in masks:
        inside = (mask > 0.5).numpy(force=True).astype(np.uint8)
        if inside.any():
            areas = cv2.connectedComponentsWithStats(inside)[2][1:, cv2.CC_STAT_AREA]
            apart.append(1 - float(areas.max() / areas.sum()))
    return max(apart)


def likely_part(
    images: Float[Tensor, "view 3 height width"], selected: Sequence[Selected]
) -> tuple[float | None, int]:
    """How likely a part of what a click took was meant instead, and the number of that reading.

    As likely as what was taken: 1. Only parts count that differ from the rest in colour, at the
    seam too, as a bear does from its plinth's shade and a fox from its plaque; of small things they
    are handles and labels. None where nothing was read in several ways.
    """
    found: list[tuple[float, int]] = []
    for one in selected:
        by_number = {reading.number: reading for reading in one.readings}
        whole = by_number.get(one.taken)
        if whole is None or "marked" not in one.how:
            continue
        photo = _small(images[whole.view])
        masks = {n: _small(r.mask) > 0.5 for n, r in by_number.items()}
        for number, reading in by_number.items():
            if _is_other_part(photo, masks[number], masks[whole.number]):
                found.append((reading.score / max(whole.score, 1e-6), number))
        found.append((0.0, whole.number))
    return max(found) if found else (None, 0)


def _is_other_part(
    photo: Float[Tensor, "3 height width"],
    part: Bool[Tensor, "height width"],
    whole: Bool[Tensor, "height width"],
) -> bool:
    """Whether something is a part of a large thing that has other colours than the rest of it."""
    area, inner = int(whole.sum()), part & whole
    is_part = int(inner.sum()) > IS_PART * int(part.sum())
    share = int(part.sum()) / max(area, 1)
    if area < LARGE * whole.numel() or not is_part or not 0.3 < share < 0.9:
        return False
    lab = rgb_to_lab(photo).movedim(0, -1).numpy(force=True).astype(np.float32)
    smooth = cv2.GaussianBlur(lab, (0, 0), 1.0)
    here, rest = inner.numpy(force=True), (whole & ~part).numpy(force=True)
    seam = [here & _near(rest), rest & _near(here)]
    if not seam[0].any() or not seam[1].any():
        return False
    means = [smooth[one].mean(0) for one in (here, rest, *seam)]
    apart = np.linalg.norm(means[0] - means[1]), np.linalg.norm(means[2] - means[3])
    return bool(min(apart) > PART_COLOUR)


def _near(where: Bool[np.ndarray, "height width"]) -> Bool[np.ndarray, "height width"]:
    return cv2.dilate(where.astype(np.uint8), np.ones((13, 13), np.uint8)) > 0


def taken(
    before: Float[Tensor, "view 3 height width"],
    after: Float[Tensor, "view 3 height width"],
    masks: Masks,
    asked: Float[Tensor, "colour 3"] | None = None,
) -> float | None:
    """Share of the masked pixels that took a colour, or look like the asked one anyway.

    None where what did not take it has an own colour far from that of what did: tyres stay black
    on a bike that is painted.
    """
    old, new = rgb_to_lab(before).movedim(1, -1), rgb_to_lab(after).movedim(1, -1)
    inside = masks > 0.5
    took = inside & ((new - old).norm(dim=-1) > CLEARLY)
    for rgb in () if asked is None else asked:
        colour = rgb_to_lab(rgb[:, None, None].to(new))[:, 0, 0]
        took |= inside & ((new - colour).norm(dim=-1) < 2 * CLEARLY)
    left = inside & ~took
    if not took.any() or not left.any():
        return 1.0
    apart = (old[took].mean(0) - old[left].mean(0))[1:].norm()
    return None if apart > OTHER_COLOUR else float(took.sum() / inside.sum())


def made_up(
    before: Float[Tensor, "view 3 height width"],
    after: Float[Tensor, "view 3 height width"],
    masks: Masks,
) -> float:
    """Share of a photo that what was removed covered, where what appears has no texture of its own.

    The largest over the views.
    """
    shares = [0.0]
    for old, new, mask in zip(before, after, masks):
        hole = (mask > 0.5).numpy(force=True).astype(np.uint8)
        inner = cv2.erode(hole, np.ones((3, 3), np.uint8)) > 0
        around = cv2.dilate(hole, np.ones((25, 25), np.uint8)) > hole
        if inner.any() and around.any():
            smoother = _steps(new)[inner].mean() < PLAIN * _steps(old)[around].mean()
            shares.append(float(hole.mean()) if smoother else 0.0)
    return max(shares)


def _small(images: Float[Tensor, "*batch height width"]) -> Float[Tensor, "*batch h w"]:
    """The images with SIDE pixels on the longer side, at most."""
    height, width = images.shape[-2:]
    scale = min(1.0, SIDE / max(height, width))
    size = (round(scale * height), round(scale * width))
    flat = images.reshape(-1, 1, height, width)
    return F.adaptive_avg_pool2d(flat, size).view(*images.shape[:-2], *size)


def measure_edit_in_3d(measures: EditMeasures, scene: EditToJudge) -> EditMeasures:
    """Add what the reconstructed scene tells of the edit."""
    views = list(scene.edited)
    measures = replace(measures, shown=change_shown(scene, views))
    if scene.masks is None or bool((scene.masks > 0).all()):
        return measures
    assert scene.rendered is not None and scene.cameras is not None  # it is a scene
    masks, depths = scene.masks[0], scene.rendered.depths[0, :, 0]
    # Of what is removed nothing shall be left, in no place: only paint can be missed.
    if measures.made_up is None:
        measures = replace(measures, missed=missed_patch(scene, views))
    return replace(measures, agreement=masks_agree(masks, depths, scene.cameras))


def outline_on_edges(
    images: Float[Tensor, "view 3 height width"], masks: Masks
) -> float | None:
    """Return how much more of the masks' outlines lies on edges than chance would put there.

    1: all of it; 0: as much as of any line. None where no mask has an outline inside its photo, or
    where edges are everywhere.
    """
    shares = []
    chances = []
    for image, mask in zip(images, masks):
        near_edge = _near_edges(image)
        outline = _outline(mask)
        if outline.any():
            shares.append(float(near_edge[outline].mean()))
            chances.append(float(near_edge.mean()))
    chance = float(np.mean(chances)) if chances else 1.0
    if chance > MAX_CHANCE:
        return None
    return (float(np.mean(shares)) - chance) / (1 - chance)


def open_outline(images: Float[Tensor, "view 3 height width"], masks: Masks) -> float:
    """Return the longest stretch of an outline with the same colours on both sides, as its share.

    Mean over the views; such a stretch is a cut through one surface.
    """
    stretches = []
    for image, mask in zip(images, masks):
        outline = _outline(mask)
        if not outline.any():
            continue
        alike = outline & (_contrast(image, mask) < SAME_COLOURS)
        joined = cv2.dilate(alike.astype(np.uint8), np.ones((3, 3), np.uint8))
        _, labels = cv2.connectedComponents(joined)
        lengths = np.bincount(labels[alike], minlength=1)
        stretches.append(lengths[1:].max(initial=0) / outline.sum())
    return float(np.mean(stretches)) if stretches else 0.0


def _contrast(
    image: Float[Tensor, "3 height width"], mask: Float[Tensor, "height width"]
) -> Float[np.ndarray, "height width"]:
    """Difference between the mean colours inside and outside, about each pixel [CIE Lab]."""
    lab = rgb_to_lab(image).movedim(0, -1).numpy(force=True).astype(np.float32)
    inside = (mask > 0.5).numpy(force=True).astype(np.float32)[..., None]

    def mean(weight: np.ndarray) -> np.ndarray:
        total = cv2.GaussianBlur(weight, (0, 0), NEAR)[..., None]
        return cv2.GaussianBlur(lab * weight, (0, 0), NEAR) / (total + 1e-6)

    return np.linalg.norm(mean(inside) - mean(1 - inside), axis=-1)


def ghost_of(
    before: Float[Tensor, "view 3 height width"],
    after: Float[Tensor, "view 3 height width"],
    masks: Masks,
) -> float | None:
    """Return the share of what was edge on a removed thing's outline that is edge still, in [0, 1].

    None where no outline lay on an edge.
    """
    was = 0
    stays = 0
    for old, new, mask in zip(before, after, masks):
        edge = _near_edges(old) & _outline(mask)
        was += int(edge.sum())
        stays += int((edge & _near_edges(new)).sum())
    return stays / was if was else None


def _near_edges(
    image: Float[Tensor, "3 height width"],
) -> Bool[np.ndarray, "height width"]:
    """Pixels within REACH of a place where the colour changes."""
    strength = _steps(image)
    kernel = cv2.getStructuringElement(
        cv2.MORPH_ELLIPSE, (2 * REACH + 1, 2 * REACH + 1)
    )
    return cv2.dilate((strength > EDGE).astype(np.uint8), kernel) > 0


def _steps(image: Float[Tensor, "3 height width"]) -> Float[np.ndarray, "height width"]:
    """How much the colour changes over two pixels [CIE Lab]."""
    lab = rgb_to_lab(image).movedim(0, -1).numpy(force=True).astype(np.float32)
    smooth = cv2.GaussianBlur(lab, (0, 0), 1.0)
    across = cv2.Sobel(smooth, cv2.CV_32F, 1, 0) / 4
    down = cv2.Sobel(smooth, cv2.CV_32F, 0, 1) / 4
    return np.sqrt((across**2 + down**2).sum(-1))


def _outline(mask: Float[Tensor, "height width"]) -> Bool[np.ndarray, "height width"]:
    """The inner pixels of a mask's outline, without the photo's border."""
    inside = (mask > 0.5).numpy(force=True).astype(np.uint8)
    inner = cv2.erode(inside, np.ones((3, 3), np.uint8), borderValue=1)
    return (inside > 0) & (inner == 0)


# ---- between photos ----


def masks_agree(masks: Masks, depths: Masks, cameras: Cameras) -> float | None:
    """Overlap of the masks of all pairs of views, on the surfaces that both show, in [0, 1].

    `depths` are camera z of the scene from the views' places, `cameras` theirs (batch 1). None
    where no two views show the selected surface.
    """
    overlaps = [
        overlap
        for first, second in permutations(range(len(masks)), 2)
        if (overlap := _overlap(masks, depths, cameras, first, second)) is not None
    ]
    return float(np.mean(overlaps)) if overlaps else None


def _overlap(
    masks: Masks, depths: Masks, cameras: Cameras, first: int, second: int
) -> float | None:
    """Overlap of the first view's mask with the second's, where the second sees the surface."""
    pair = [first, second]
    grid, same = shared_surface(
        depths[pair], cameras.intrinsics[0, pair], cameras.c2w[0, pair], SAME_SURFACE
    )
    other = warp(masks[second, None], grid, padding="zeros")[0]
    own = masks[first] * same
    other = other * same
    either = float(torch.maximum(own, other).sum())
    return float(torch.minimum(own, other).sum()) / either if either > 50 else None


def change_shown(scene: EditToJudge, views: Sequence[int]) -> float | None:
    """Share of the 2D change that the scene shows; None where nothing was changed."""
    assert scene.rendered is not None  # it is a scene
    size = size_of(scene.rendered.images)
    before = scene.before.at(size).images[:, views]
    wanted = scene.after.at(size).images[:, views] - before
    if float(wanted.abs().amax()) < VISIBLE:
        return None
    weight = torch.ones_like(wanted)
    if scene.masks is not None:
        weight *= (scene.masks[:, views] > 0.5)[:, :, None]
    return change_uptake(
        scene.rendered.images[:, views].clamp(0, 1) - before, wanted, weight
    )


def missed_patch(scene: EditToJudge, views: Sequence[int]) -> float:
    """Largest connected patch that changed clearly in 2D and is as it was in 3D, as a share.

    Of all that changed in its view; the largest over the views. Photos that disagree about what
    belongs to the thing leave such patches, and so do surfaces of another photo in front of it.
    """
    assert scene.rendered is not None  # it is a scene
    size = size_of(scene.rendered.images)
    photos = (scene.before.at(size).images, scene.after.at(size).images)
    triples = zip(*(_small(one[0, views]) for one in (*photos, scene.rendered.images)))
    return max((_missed_in(*triple) for triple in triples), default=0.0)


def _missed_in(
    before: Float[Tensor, "3 height width"],
    after: Float[Tensor, "3 height width"],
    shown: Float[Tensor, "3 height width"],
) -> float:
    wanted, got = after - before, shown.clamp(0, 1) - before
    changed = (wanted.abs().amax(0) > CLEAR_CHANGE).numpy(force=True)
    arrived, asked = (
        cv2.GaussianBlur(one.sum(0).numpy(force=True), (0, 0), PATCH_BLUR)
        for one in (wanted * got, wanted * wanted)
    )
    missing = (changed & (arrived < ARRIVED * asked)).astype(np.uint8)
    areas = cv2.connectedComponentsWithStats(missing)[2][1:, cv2.CC_STAT_AREA]
    if not len(areas) or changed.sum() < LEAST_CHANGED:
        return 0.0
    return float(areas.max() / changed.sum())


# ---- what was asked for ----


def _reached(
    before: Float[Tensor, "view 3 height width"],
    after: Float[Tensor, "view 3 height width"],
    visibly: Bool[Tensor, "view height width"],
    instructions: Sequence[Instruction],
    regions: Float[Tensor, "instruction view height width"] | None,
) -> float | None:
    """Share of the visible change that looks as asked; None where none can be checked."""
    shares = []
    colours_before = rgb_to_lab(before).movedim(1, -1)
    colours_after = rgb_to_lab(after).movedim(1, -1)
    for number, instruction in enumerate(instructions):
        place = visibly
        if regions is not None:
            place = visibly & (regions[number] > 0.5)
        if not place.any():
            continue
        shares += list(
            _shares(instruction.changes, colours_before[place], colours_after[place])
        )
    return min(shares, default=None)


def _shares(
    changes: Sequence[Change],
    old: Float[Tensor, "pixel 3"],
    new: Float[Tensor, "pixel 3"],
) -> Iterator[float]:
    """Each change's share of the difference of colours that is as it asks.

    By how much pixels changed, not by their number: a rim or a reflection that took a little of
    the colour stays grey, and nobody sees it.
    """
    chroma = new[:, 1:].norm(dim=1)
    size = (new - old).norm(dim=1)
    for change in changes:
        if change.kind == "paint" and change.colour is not None:
            yield _part(size, _has_colour(new, change.colour.rgb))
        elif change.kind == "greyscale":
            yield _part(size, chroma < GREY)
        elif change.kind == "brightness":
            moved = (new[:, 0] - old[:, 0]).mean() * change.amount
            yield float(moved > 0)


def _part(size: Float[Tensor, "pixel"], where: Bool[Tensor, "pixel"]) -> float:
    return float((size * where).sum() / size.sum())


def _has_colour(
    colours: Float[Tensor, "pixel 3"], rgb: tuple[float, float, float]
) -> Bool[Tensor, "pixel"]:
    """Whether each has the hue of a colour, or is as grey as it."""
    wanted = rgb_to_lab(colours.new_tensor(rgb)[:, None, None])[:, 0, 0]
    if float(wanted[1:].norm()) < 2 * GREY:
        return colours[:, 1:].norm(dim=1) < 2 * GREY
    return _hue_apart(colours, wanted) < HUE_TOLERANCE


def _hue_apart(
    colours: Float[Tensor, "pixel 3"], wanted: Float[Tensor, "3"]
) -> Float[Tensor, "pixel"]:
    """Angle between hues [degrees]."""
    hue = torch.atan2(colours[:, 2], colours[:, 1])
    apart = hue - torch.atan2(wanted[2], wanted[1])
    return torch.rad2deg(torch.atan2(apart.sin(), apart.cos()).abs())
