"""The selector `in-scene`: what is meant on few pictures is a choice of Gaussians, which show it on
all pictures.
"""

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import (
    Candidate,
    Geometry,
    Rasterizer,
    Segmenter,
    Selected,
    Selection,
    Selector,
    StartsFromScene,
)
from edit3r.contract.reporting import say
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import GivenScene, Views
from edit3r.kit.compute.outlines import box_around
from edit3r.kit.geometry.cameras import project_to_pixels
from edit3r.kit.rendering import render_numbers
from edit3r.running import usual_selector
from edit3r_in_place.belonging import SHARE, Contribution, belonging, evidence

# The numbers of this block: no figures kept.
LOOKS = 3  # pictures on which a segmenter is asked, at most
WORDS_ON = 3  # pictures on which words are looked for
NEW = 0.15  # share of the thing in a picture that no other picture showed, for another look
SAME = 0.55  # overlap from which a further look confirms what is expected
SOLID = 0.2  # alpha from which a place is on the scene
GAP = 0.1  # of a thing, through which what is behind shows [its widths]
DEEP = 0.5  # how far behind its nearest surface a thing goes on [its widths]
SMALLEST = 3e-4  # share of a picture under which a thing does not show
CERTAIN = 0.9  # share of a thing's pixels around which it is clicked on
WHOLE = (
    0.9  # share of what a picture shows of the scene, from which a thing is all of it
)

Mask = Float[Tensor, "height width"]


class InSceneSelector(Selector, StartsFromScene):
    """Asks the usual selector on few pictures; the scene's Gaussians carry its answer to all.

    Without a given scene it is the usual selector itself.
    """

    class Settings(edit3r.Settings):
        segmenter: PartChoice = PartChoice(name="auto")
        """answers marks and words on one picture"""
        rasterizer: PartChoice = PartChoice(name="auto")
        """shows what is chosen"""

    settings: Settings
    scene: GivenScene | None = None

    def __init__(self, settings: Settings, segmenter: Segmenter) -> None:
        super().__init__(settings)
        self.usual = usual_selector(segmenter)

    def starting_from(self, scene: GivenScene) -> "InSceneSelector":
        started = copy(self)
        started.scene = scene
        return started

    def select(
        self, views: Views, selection: Selection, geometry: Geometry | None = None
    ) -> Selected:
        if self.scene is None or len(selection.masks) == views.count:
            return self.usual.select(views, selection, geometry)
        _check_places(selection, self.scene)
        looked_at = list(selection.views) or _spread(views.count, WORDS_ON)
        plain = replace(selection, inverted=False, grow=0.0)
        part = None if geometry is None else _of_views(geometry, looked_at)
        asked = _renumbered(plain, {view: new for new, view in enumerate(looked_at)})
        found = self.usual.select(views.select(looked_at), asked, part)
        alphas, number = self.scene.alphas[0, looked_at], selection.candidate
        smaller = _part_of_scene(found, selection, alphas)
        on_scene = () if selection.says_where else _on_scene(found, alphas)
        if smaller > 1:
            say(
                "selection.part",
                f"the {selection.words} is taken for a part of the scene; "
                "'paint everything' is said of all of it",
            )
            number = smaller
        elif on_scene:
            number = on_scene[min(number, len(on_scene)) - 1].number
        if number != selection.candidate:
            asked = replace(asked, candidate=number)
            found = self.usual.select(views.select(looked_at), asked, part)
        if on_scene:  # counted anew
            own = enumerate(on_scene, start=1)
            found = replace(
                found,
                candidates=tuple(replace(one, number=count) for count, one in own),
                taken=min(selection.candidate, len(on_scene)),
            )
        masks = dict(zip(looked_at, found.masks[:, 0]))
        rasterizer = edit3r.default_registry().build_choice(
            "rasterizer", self.settings.rasterizer
        )
        lifting = _Lifting(self.scene, rasterizer)
        shown = lifting.evidence_of(masks)
        share = belonging(self.scene.gaussians, shown)
        while len(masks) < LOOKS and selection.says_where:
            view = lifting.next_view(share, shown, set(masks))
            if view is None:
                break
            expected = lifting.shown_in(view, share)
            mask = self._look_again(views.select([view]), plain, expected)
            masks[view] = expected if mask is None else mask
            shown = shown + lifting.evidence_of({view: masks[view]})
            share = belonging(self.scene.gaussians, shown)
        final = lifting.on_all(share > SHARE)
        for view in selection.views:  # marks are obeyed to the pixel
            final[view] = masks[view]
        say(
            "selection.looked",
            f"on {len(masks)} of {views.count} pictures of the scene",
        )
        return self._selected(selection, found, looked_at, final)

    def _look_again(
        self, view: Views, selection: Selection, expected: Mask
    ) -> Mask | None:
        """The thing on a further picture, clicked on where it surely is; None for another one."""
        marks = Selection(
            positive=tuple((0, *place) for place in _inner(expected)),
            boxes={0: box_around(expected.numpy() > 0.5)},
        )
        mask = self.usual.select(view, marks, None).masks[0, 0]
        both, either = (mask > 0.5) & (expected > 0.5), (mask > 0.5) | (expected > 0.5)
        same = float(both.sum()) >= SAME * float(either.sum())
        return mask if same else None

    def _selected(
        self,
        selection: Selection,
        found: Selected,
        looked_at: list[int],
        masks: Float[Tensor, "view height width"],
    ) -> Selected:
        how = dict(zip(looked_at, found.how))
        candidates = tuple(
            replace(one, view=looked_at[one.view]) for one in found.candidates
        )
        if selection.inverted:
            masks = 1 - masks
        return replace(
            found,
            masks=masks[:, None],
            how=tuple(how.get(view, "geometry") for view in range(len(masks))),
            candidates=candidates,
        )


@dataclass(frozen=True)
class _Lifting:
    """Masks of pictures become a choice of Gaussians, and a choice is seen on pictures."""

    scene: GivenScene
    rasterizer: Rasterizer

    def evidence_of(self, masks: Mapping[int, Mask]) -> Contribution:
        """What pictures say of each Gaussian; nothing of those seen through gaps of the thing."""
        gaussians, nothing = self.scene.gaussians, torch.zeros(())
        told = Contribution(nothing, nothing)
        for view, mask in masks.items():
            camera = self.scene.cameras.select([view])
            shown = evidence(gaussians, camera, mask[None], self.rasterizer)
            front = ~self._is_behind(view, mask)
            told = told + Contribution(shown.within * front, shown.total * front)
        return told

    def _is_behind(self, view: int, mask: Mask) -> Bool[Tensor, "gaussian"]:
        """Which Gaussians lie far behind what a mask of a picture covers, as a lawn behind flowers
        does that shows between their leaves.
        """
        camera, inside = self.scene.cameras.select([view]), mask > 0.5
        means, width = self.scene.gaussians.means[0], float(inside.sum()) ** 0.5
        depths = self.scene.depths[0, view]
        depths = torch.where(inside & (depths > 0), depths, torch.inf)
        gap = round(GAP * width)
        nearest = -F.max_pool2d(-depths[None], 2 * gap + 1, 1, gap)[0]
        lens, pose = camera.intrinsics[0, 0], camera.c2w[0, 0]
        deepest = nearest * (1 + DEEP * width / (lens[0, 0] * inside.shape[1]))
        deepest = torch.where(inside, deepest, torch.inf)
        index, z, within = project_to_pixels(means, lens, pose, (*inside.shape,))
        return within & (z > deepest.flatten()[index.clamp(0, inside.numel() - 1)])

    def next_view(
        self, share: Float[Tensor, "gaussian"], shown: Contribution, done: set[int]
    ) -> int | None:
        """The picture that shows most of the thing that no other one showed; None for little."""
        news = share * (~shown.seen)
        best, most = None, 0.0
        for view in set(range(self.scene.cameras.count)) - done:
            whole, new = self.shown_in(view, share), self.shown_in(view, news)
            large = float(whole.mean()) > SMALLEST
            if large and float(new.sum()) > max(most, NEW * float(whole.sum())):
                best, most = view, float(new.sum())
        return best

    def shown_in(self, view: int, share: Float[Tensor, "gaussian"]) -> Mask:
        """How much of each pixel of a picture shows what belongs to the thing."""
        camera = self.scene.cameras.select([view])
        rendered = render_numbers(
            self.rasterizer, self.scene.gaussians, share[None], camera
        )
        return rendered.images[0, 0, 0].clamp(0, 1)

    def on_all(
        self, chosen: Bool[Tensor, "gaussian"]
    ) -> Float[Tensor, "view height width"]:
        """What is chosen, on all pictures, as a share of what each pixel shows of the scene."""
        every = [
            self.shown_in(view, chosen.float())
            for view in range(self.scene.cameras.count)
        ]
        share = torch.stack(every) / self.scene.alphas[0].clamp(min=1e-3)
        return torch.where(share > 0.02, share, 0.0).clamp(0, 1)


def _check_places(selection: Selection, scene: GivenScene) -> None:
    """Raise InputError for a click on the background of a scene."""
    alphas = scene.alphas[0]
    height, width = alphas.shape[1:]
    strokes = [(view, *places[0]) for view, places in selection.strokes]
    for view, x, y in (*selection.positive, *strokes):
        if view >= len(alphas):
            continue
        row, column = min(int(y * height), height - 1), min(int(x * width), width - 1)
        if float(alphas[view, row, column]) < SOLID:
            raise InputError(
                f"the mark at {x:.2f}, {y:.2f} of picture {view + 1} lies on nothing, beside the "
                "scene; look at the pictures with --preview and mark a thing."
            )


def _part_of_scene(
    found: Selected,
    selection: Selection,
    alphas: Float[Tensor, "view height width"],
) -> int:
    """The candidate that takes what a click and a name mean, where the first is all of the scene.

    A thing that stands alone has the clearest outline there is; who names what is clicked on means
    one thing of several.
    """
    left_open = selection.candidate == 1 and not selection.larger and not found.fits
    if not (left_open and selection.words and selection.positive):
        return 1
    smaller = [
        one.number
        for one in found.candidates
        if float((one.mask * alphas[one.view]).sum())
        < WHOLE * float(alphas[one.view].sum())
    ]
    return min(smaller, default=1)


def _on_scene(
    found: Selected, alphas: Float[Tensor, "view height width"]
) -> tuple[Candidate, ...]:
    """The candidates that lie on the scene: what stands out most on a picture of it may be the
    background.
    """
    solid = (alphas >= SOLID).float()
    return tuple(
        one
        for one in found.candidates
        if float((one.mask * solid[one.view]).sum()) > 0.5 * float(one.mask.sum())
    )


def _spread(count: int, wanted: int) -> list[int]:
    """So many of `count` views, evenly taken."""
    step = max(1, round(count / wanted))
    return list(range(0, count, step))[:wanted]


def _of_views(geometry: Geometry, views: list[int]) -> Geometry:
    lens = geometry.intrinsics
    return replace(
        geometry,
        c2w=geometry.c2w[:, views],
        depths=geometry.depths[:, views],
        confidence=geometry.confidence[:, views],
        registered=geometry.registered[:, views],
        intrinsics=None if lens is None else lens[:, views],
    )


def _renumbered(selection: Selection, new: Mapping[int, int]) -> Selection:
    """The marks by other numbers of their views."""

    def placed(marks: tuple) -> tuple:
        return tuple((new[view], *rest) for view, *rest in marks)

    def keyed(marks: Mapping) -> dict:
        return {new[view]: value for view, value in marks.items()}

    return replace(
        selection,
        positive=placed(selection.positive),
        negative=placed(selection.negative),
        strokes=placed(selection.strokes),
        regions=placed(selection.regions),
        boxes=keyed(selection.boxes),
        added=keyed(selection.added),
        removed=keyed(selection.removed),
        masks=keyed(selection.masks),
    )


def _inner(mask: Mask) -> list[tuple[float, float]]:
    """The innermost place of a thing."""
    inside = (mask.numpy() > CERTAIN).astype(np.uint8)
    if not inside.any():
        inside = (mask.numpy() > 0.5).astype(np.uint8)
    depth = cv2.distanceTransform(np.pad(inside, 1), cv2.DIST_L2, 3)[1:-1, 1:-1]
    row, column = np.unravel_index(int(depth.argmax()), depth.shape)
    height, width = depth.shape
    return [((int(column) + 0.5) / width, (int(row) + 0.5) / height)]
