"""The editor `retouch`: takes away what is masked and shows what the other photos see behind it.

What another photo sees is carried over by the matched geometry, which no editor of single pictures
can do; only what no photo sees is invented, from the patterns around it, once for all photos.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor

import edit3r
from edit3r.contract.errors import MatchingError, PromptError
from edit3r.contract.instructions import Instruction, Target
from edit3r.contract.interfaces import (
    ChangesShape,
    Editor,
    EditsRegions,
    Geometry,
    Matcher,
)
from edit3r.contract.reporting import note, warn
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.geometry.cameras import project, project_to_pixels, unproject
from edit3r.kit.geometry.maps import dilate
from edit3r.kit.geometry.warping import warp
from edit3r_editors.patterns import with_patterns

# By eye, but for MAX_ERROR_BESIDE: docs/notes/recoloring.md.
# relative difference in depth within which a surface is taken to be the one that is looked for
NEAR = 0.1
# confidence above which a depth was measured; filled-in depths bleed over the edges of what is
# removed
SURE = 0.5
# of what another photo shows beside a hole: largest mean error, as a share of the contrast there
MAX_ERROR_BESIDE = 0.3
NOISE = 0.01  # error that photos of one surface have anyway
BESIDE = 0.06  # how far from a hole its surroundings reach [longer sides]
STANDS = 0.05  # relative difference in depth within which things touch each other
# share of the removed thing's size from which what is left is worth a word
LEAST_LEFT = 0.1
SHADOW = 0.75  # share of the light around below which a pixel is in shadow
MAX_TINT = 0.15  # difference of the channels' shares within a shadow
DARK = 0.1  # light below which no shadow is told from the ground


class RetouchEditor(Editor, ChangesShape, EditsRegions):
    """Removes what `request.masks` cover; the prompt only says to the segmenter what that is."""

    class Settings(edit3r.Settings):
        matcher: PartChoice = PartChoice(name="classical")
        """measures poses and depth of the photos"""
        margin: int = Field(1, ge=0, le=20)
        """pixels around what is removed that are not trusted as background"""
        rim: float = Field(0.008, ge=0, le=0.1)
        """how much beyond the mask is removed too [longer sides]"""
        shadow: float = Field(0.03, ge=0, le=0.3)
        """how far from the thing its shadow is removed too [longer sides]"""

    settings: Settings

    def __init__(self, settings: Settings, matcher: Matcher) -> None:
        self.settings, self.matcher = settings, matcher

    def understands(self, instruction: Instruction) -> bool:
        scope = instruction.target.scope
        return instruction.action == "remove" and scope in ("named", "marked")

    def instruction_of_nothing(self) -> Instruction:
        return Instruction("remove", Target("marked"), text="remove what is marked")

    def widened(
        self,
        regions: Float[Tensor, "instruction batch view height width"],
        images: Float[Tensor, "batch view 3 height width"],
    ) -> Float[Tensor, "instruction batch view height width"]:
        """The things with their shadows, and with their rims, where colours are mixed."""
        longer = max(images.shape[-2:])
        wide = dilate((regions > 0).to(regions), math.ceil(self.settings.rim * longer))
        reach = math.ceil(self.settings.shadow * longer)
        photos = images.expand(len(wide), *images.shape).flatten(0, 2)
        pairs = zip(wide.flatten(0, 2), photos)
        shadows = torch.stack([_shadow(mask, photo, reach) for mask, photo in pairs])
        return torch.maximum(wide, shadows.view_as(wide))

    def edit(self, views: Views, request: EditRequest) -> Views:
        if request.masks is None:
            raise PromptError(
                "editor 'retouch' removes what is marked, and nothing is: click on it "
                "(--point X,Y), or give --mask FILE for each photo."
            )
        geometry = self._geometry(views)
        scenes = [
            self._scene(views, request.masks > 0, geometry, scene)
            for scene in range(len(views.images))
        ]
        return replace(views, images=torch.stack(scenes))

    def _scene(
        self,
        views: Views,
        holes: Bool[Tensor, "b view height width"],
        geometry: Geometry | None,
        scene: int,
    ) -> Float[Tensor, "view 3 height width"]:
        """The images of one scene of the batch, with its holes filled."""
        images, hole = views.images[scene], holes[scene]
        seen, hidden = torch.zeros_like(hole), None
        if geometry is not None:
            _tell_what_is_left(hole, geometry.depths[scene])
            margin, views = self.settings.margin, geometry.calibrated(views)
            images, seen, hidden = behind(views, hole, geometry, scene, margin)
        shares = [
            round(float(s[h].float().mean()), 3) if h.any() else None
            for s, h in zip(seen, hole)
        ]
        note("retouch.seen_by_other_photos", shares)
        if max((share for share in shares if share is not None), default=1) < 0.5:
            warn(
                "most of what is taken away hides what no other photo shows; what is behind it "
                "is invented."
            )
        unseen = hole & ~seen
        if geometry is None or hidden is None:
            return torch.stack([inpainted(*one) for one in zip(images, unseen)])
        placed = geometry.registered[scene].tolist()
        lenses, poses = views.intrinsics[scene], geometry.c2w[scene]
        return _invented(images, unseen, hidden, placed, lenses, poses)

    def _geometry(self, views: Views) -> Geometry | None:
        """Geometry of the photos; None where they cannot be placed."""
        try:
            return self.matcher.match(views)
        except MatchingError as error:
            warn(
                "retouch: what is behind the object is invented, since the photos could not be "
                f"matched: {error}"
            )
            return None


def _tell_what_is_left(
    holes: Bool[Tensor, "view height width"], depths: Float[Tensor, "view height width"]
) -> None:
    """Warn where most photos show something standing on or in what is removed: it would float."""
    shown = [pair for pair in zip(holes, depths) if pair[0].any()]
    left = [pair for pair in shown if standing_on(*pair).any()]
    if len(left) > len(shown) / 2:
        warn(
            "something that stands on or in what is removed seems to be left: remove it too, by a "
            "further click on it, or by --box around both."
        )


def standing_on(
    hole: Bool[Tensor, "height width"], depth: Float[Tensor, "height width"]
) -> Bool[Tensor, "height width"]:
    """Pixels of what stands on the removed thing and on nothing else.

    It is as far away as the upper edge of the thing, touches it there, and nowhere meets what lies
    beside the thing's lower half or the border of the photo, as a table or a wall would.
    """
    rows, columns = hole.nonzero(as_tuple=True)
    nothing = torch.zeros_like(hole)
    if not len(rows) or int(rows.min()) == 0:
        return nothing
    reach = max(2, math.ceil(BESIDE * max(hole.shape) / 4))
    beside = (dilate(hole[None].float(), reach)[0] > 0) & ~hole
    places = torch.arange(len(hole)).to(rows)[:, None]
    upper = places < rows.double().mean()
    tops = torch.where(hole, places, len(hole)).amin(0)
    own = torch.stack([depth[tops[x], x] for x in columns.unique()]).median()
    alike = ~hole & ((depth / own - 1).abs() < STANDS)
    shape = alike.cpu().numpy().astype(np.uint8)
    _, labels = cv2.connectedComponents(shape, connectivity=4)
    parts = torch.from_numpy(labels).to(hole.device)
    border = torch.cat((parts[0], parts[-1], parts[:, 0], parts[:, -1]))
    held = torch.cat((border, parts[beside & ~upper])).unique()
    standing = alike & ~torch.isin(parts, held) & (parts > 0)
    touching = parts[standing & beside & upper].unique()
    least = LEAST_LEFT * hole.sum()
    large = [part for part in touching if (parts == part).sum() > least]
    return torch.isin(parts, torch.stack(large)) if large else nothing


def _shadow(
    mask: Float[Tensor, "height width"],
    image: Float[Tensor, "3 height width"],
    reach: int,
) -> Float[Tensor, "height width"]:
    """1 for pixels within `reach` that touch the mask's lower half and lie in its shadow.

    Shadow is darker than what lies beyond, alike in all channels. Photos are taken to be upright.
    """
    if not mask.any():
        return mask
    near = dilate(mask[None], reach)[0] > 0
    known = torch.where(near, torch.zeros_like(image), image.clamp(min=1e-3))
    beyond = torch.stack([spanned(one) for one in known.cpu()])
    share = image / beyond.to(image).clamp(min=DARK)
    grey = share.amax(0) - share.amin(0) < MAX_TINT
    rows = mask.nonzero()[:, 0]
    below = torch.arange(len(mask)).to(rows)[:, None] > rows.double().mean()
    dark = (share.amax(0) < SHADOW) & (beyond.amin(0).to(image) > DARK)
    dark = dark & near & below & grey
    joined = ((mask > 0) | dark).cpu().numpy().astype(np.uint8)
    _, labels = cv2.connectedComponents(joined)
    touching = np.isin(labels, labels[mask.cpu().numpy() > 0])
    return torch.from_numpy(touching & dark.cpu().numpy()).to(mask)


def behind(
    views: Views,
    holes: Bool[Tensor, "view height width"],
    geometry: Geometry,
    scene: int,
    margin: int,
) -> tuple[
    Float[Tensor, "view 3 height width"],
    Bool[Tensor, "view height width"],
    Float[Tensor, "view height width"],
]:
    """Images of one scene of the batch whose holes show what its other views see there, where that
    was so, and the depths of the surface behind (elsewhere, and without other views, as matched).

    The surface behind a hole is spanned between the depths measured around it and those that other
    views measured and carry into it. A view lends no pixels within `margin` of its own hole.
    """
    images = views.images[scene]
    intrinsics = views.intrinsics[scene]
    c2w = geometry.c2w[scene]
    depths, placed = geometry.depths[scene], geometry.registered[scene]
    lent = dilate(holes.to(images), margin) == 0
    sure = lent & (geometry.confidence[scene] > SURE)
    points = unproject(depths, intrinsics, c2w)
    filled, seen, hidden = images.clone(), torch.zeros_like(holes), depths.clone()
    for view in range(len(images)):
        others = [o for o in range(len(images)) if o != view and placed[o]]
        if not (placed[view] and others and holes[view].any()):
            continue
        apart = (c2w[:, :3, 3] - c2w[view, :3, 3]).norm(dim=-1).tolist()
        others.sort(key=apart.__getitem__)
        known = torch.where(sure[view], 1 / depths[view], 0.0)
        sources = torch.cat([points[o][sure[o]] for o in others])
        hole, lens, pose = holes[view], intrinsics[view], c2w[view]
        carried = _carried(sources, lens, pose, hole)
        inverse = spanned(torch.where(hole, carried, known)).to(depths)
        # never before what is removed
        background = 1 / torch.minimum(inverse, 1 / depths[view]).clamp(min=1e-9)
        hidden[view] = torch.where(hole, background, depths[view])
        surface = unproject(background, lens, pose)
        lenders = (
            _lent(
                surface, images[o], depths[o], sure[o], lent[o], intrinsics[o], c2w[o]
            )
            for o in others
        )
        pixels, shown, agrees = (torch.stack(part) for part in zip(*lenders))
        right = _right_beside(images[view], hole, pixels, shown)
        shown &= right
        agrees &= right
        # What one of several photos alone shows, against its own depth, is more often wrong than
        # what is inpainted.
        trusted = agrees.any(0) | (shown.sum(0) >= min(2, len(others)))
        best = torch.where(agrees.any(0), agrees, shown).int().argmax(0)
        first = pixels.gather(0, best.expand(1, 3, -1, -1))[0]
        seen[view] = hole & trusted
        filled[view] = torch.where(seen[view], first, images[view])
    return filled, seen, hidden


def _invented(
    images: Float[Tensor, "view 3 height width"],
    unseen: Bool[Tensor, "view height width"],
    depths: Float[Tensor, "view height width"],
    placed: Sequence[bool],
    intrinsics: Float[Tensor, "view 3 3"],
    c2w: Float[Tensor, "view 4 4"],
) -> Float[Tensor, "view 3 height width"]:
    """The images with what no photo saw: invented where most of it lies, and shown alike by all
    others whose `depths` of what is behind agree.
    """
    filled, done = images.clone(), list[int]()
    for view in unseen.flatten(1).sum(1).argsort(descending=True).tolist():
        gap = unseen[view].clone()
        points = unproject(depths[view], intrinsics[view], c2w[view])
        for other in done if placed[view] else ():
            invented, lens, pose = unseen[other], intrinsics[other], c2w[other]
            shown, _, agrees = _lent(
                points, filled[other], depths[other], invented, invented, lens, pose
            )
            same = gap & agrees
            filled[view] = torch.where(same, shown, filled[view])
            gap &= ~same
        filled[view] = inpainted(filled[view], gap)
        done += [view] * placed[view]
    return filled


def _lent(
    points: Float[Tensor, "height width 3"],
    image: Float[Tensor, "3 height width"],
    depth: Float[Tensor, "height width"],
    sure: Bool[Tensor, "height width"],
    lent: Bool[Tensor, "height width"],
    intrinsics: Float[Tensor, "3 3"],
    c2w: Float[Tensor, "4 4"],
) -> tuple[Tensor, Tensor, Tensor]:
    """What a view shows at points `[3, height, width]`; masks of where nothing measured hides them
    there, and where its depth says so too.
    """
    grid, z = project(points.flatten(0, 1), intrinsics, c2w)
    grid, z = grid.view(*depth.shape, 2), z.view_as(depth)
    maps = torch.stack((depth, torch.where(sure, depth, torch.inf)))
    surface, measured = warp(maps, grid, mode="nearest")
    inside = warp(lent[None].to(image), grid, padding="zeros")[0] > 0.99
    shown = inside & (z > 0) & (z < (1 + NEAR) * measured)
    return warp(image, grid), shown, shown & ((z / surface - 1).abs() < NEAR)


def _right_beside(
    image: Float[Tensor, "3 height width"],
    hole: Bool[Tensor, "height width"],
    pixels: Float[Tensor, "lender 3 height width"],
    shown: Bool[Tensor, "lender height width"],
) -> Bool[Tensor, "lender 1 1"]:
    """Whether what the lenders show beside the hole is what the photo itself shows there.

    Where it is not, poses or depths are wrong, and what they show in the hole is wrong too.
    """
    reach = math.ceil(BESIDE * max(hole.shape))
    near = dilate(hole[None].to(image), reach)[0] > dilate(hole[None].to(image), 1)[0]
    right = []
    for lent, where in zip(pixels, shown & near):
        own = image[:, where]
        error = (own - lent[:, where]).abs().mean()
        contrast = (own - own.mean(1, keepdim=True)).abs().mean()
        right.append(bool(error <= MAX_ERROR_BESIDE * contrast + NOISE))
    return torch.tensor(right, device=hole.device)[:, None, None]


def _carried(
    points: Float[Tensor, "point 3"],
    intrinsics: Float[Tensor, "3 3"],
    c2w: Float[Tensor, "4 4"],
    hole: Bool[Tensor, "height width"],
) -> Float[Tensor, "height width"]:
    """Inverse camera z of the nearest point in each pixel of the hole; 0: there is none."""
    height, width = hole.shape
    index, z, inside = project_to_pixels(points, intrinsics, c2w, (height, width))
    nearest = z.new_zeros(height * width)
    nearest = nearest.scatter_reduce(0, index[inside], 1 / z[inside], "amax")
    nearest = nearest.view(height, width)
    # Points of a farther surface show through the gaps of a nearer one: they do not count beside
    # it.
    clear = nearest >= 0.9 * dilate(nearest[None], 1)[0]
    return torch.where(hole & clear, nearest, 0.0)


def spanned(values: Float[Tensor, "height width"]) -> Float[Tensor, "height width"]:
    """The map, its zeros filled by a membrane that continues planes; on the CPU."""
    return torch.from_numpy(_membrane(values.numpy(force=True)))


def _membrane(
    values: Float[np.ndarray, "height width"],
) -> Float[np.ndarray, "height width"]:
    """Laplace's equation, solved on maps of half the sides first."""
    known, (height, width) = values > 0, values.shape
    if known.all() or min(height, width) < 4:
        mean = values[known].mean() if known.any() else 0
        return np.where(known, values, mean).astype(values.dtype)
    half = (width // 2, height // 2)
    weight = cv2.resize(known.astype(values.dtype), half, interpolation=cv2.INTER_AREA)
    low = cv2.resize(values, half, interpolation=cv2.INTER_AREA)
    smooth = cv2.resize(_membrane(low / np.maximum(weight, 1e-6)), (width, height))
    for _ in range(30):
        smooth = np.where(known, values, cv2.blur(smooth, (3, 3)))
    return smooth


def smoothed(
    image: Float[Tensor, "3 height width"], hole: Bool[Tensor, "height width"]
) -> Float[Tensor, "3 height width"]:
    """The image with the hole spanned from its surroundings."""
    known = torch.where(hole, 0.0, image + 1)  # 0 is unknown
    smooth = torch.stack([spanned(one) for one in known]).to(image) - 1
    return torch.where(hole, smooth.clamp(0, 1), image)


def inpainted(
    image: Float[Tensor, "3 height width"], hole: Bool[Tensor, "height width"]
) -> Float[Tensor, "3 height width"]:
    """The image with the hole spanned from its surroundings, and their patterns in it."""
    if not hole.any():
        return image
    picture = smoothed(image, hole).permute(1, 2, 0).numpy(force=True)
    patterned = torch.from_numpy(with_patterns(picture, hole.numpy(force=True)))
    return torch.where(hole, patterned.permute(2, 0, 1).to(image), image)
