"""What tells how an edit was carried out on what was selected: eight signals, each a figure with a
meaning, none of which knows what a person meant.

A signal is None where it cannot be told. Its limit stands in `fitted.yaml`, beyond which the edit
is doubtful; `edit3r judge --fit` chooses it by edits that were made well and badly on purpose.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import permutations
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.interfaces import EditToJudge
from edit3r.kit.compute.colour import rgb_to_lab
from edit3r.kit.files.configs import read_yaml
from edit3r.kit.geometry.cameras import project, unproject
from edit3r.kit.geometry.maps import dilate
from edit3r.kit.geometry.warping import shared_surface, warp

FITTED = Path(__file__).with_name("fitted.yaml")
SIDE = 256  # longer side at which pictures are looked at [pixels]
SEEN = 6.0  # difference of colours that one sees [CIE Lab]
CLEAR = 12.0  # difference of colours that nobody overlooks [CIE Lab]
GREY = 8.0  # chroma below which a colour is grey [CIE Lab]
BAND = 3  # pixels about an outline: its rim, and what blurs across it
SAME_SURFACE = 0.05  # relative difference of depths within which it is one surface
HUE = 25.0  # how far a hue may be from the one that was asked for [degrees]
BIN = 10.0  # difference within which colours are one [CIE Lab]
LIKE = 0.1  # share of a colour that changed, from which all of it could
FEW = 30  # pixels below which nothing is told

Maps = Float[Tensor, "view height width"]
Where = Bool[Tensor, "view height width"]


@cache
def limits_of_edits() -> Mapping[str, float]:
    """By signal; see `fitted.yaml`."""
    return _limits()["edit"]


@cache
def limits_of_scenes() -> Mapping[str, Mapping[str, float]]:
    """By label and signal; see `fitted.yaml`."""
    return _limits()["scene"]


def _limits() -> dict[str, Any]:
    return read_yaml(FITTED)


class Pictures:
    """An edit's photos before and after, and the scene from their places, as signals see them."""

    def __init__(self, edit: EditToJudge) -> None:
        views = list(edit.edited)
        self.edit, self.views = edit, views
        self.old, self.new = (
            _lab(one.images[0, views]) for one in (edit.before, edit.after)
        )
        self.shown = (
            None if edit.rendered is None else _lab(edit.rendered.images[0, views])
        )
        whole = torch.ones_like(self.old[:, 0])
        masks = whole if edit.masks is None else _small(edit.masks[0, views])
        self.inside = masks > 0.5
        self.touched = masks > 0.02  # soft edges may change a little
        self.confined = not bool(self.inside.all())
        self.kinds = {
            change.kind
            for instruction in edit.instructions
            for change in instruction.changes
        }
        self.asked = [
            change.colour.rgb
            for instruction in edit.instructions
            for change in instruction.changes
            if change.colour is not None
        ]
        self.removes = any(
            instruction.action == "remove" for instruction in edit.instructions
        )

    @cached_property
    def change(self) -> Maps:
        """How much each pixel changed [CIE Lab]."""
        return (self.new - self.old).norm(dim=1)

    @cached_property
    def can_change(self) -> Where:
        """What is selected and does not look as asked already: grey has no colour to lose."""
        if self.kinds == {"greyscale"}:
            return self.inside & (self.old[:, 1:].norm(dim=1) > GREY)
        can = self.inside
        for rgb in self.asked if self.kinds == {"paint"} else ():
            goal = _lab_of(rgb).to(self.old)[:, None, None]
            can = can & ((self.old - goal).norm(dim=1) > 2 * CLEAR)
        return can

    @cached_property
    def could_change(self) -> Where:
        """What can change, and has a colour of which some did; all of it where nothing did.

        The tyres of a bike that is painted stay black.
        """
        could = self.can_change.clone()
        for old, change, can in zip(self.old, self.change, could):
            did = (change[can] >= SEEN).double()
            if not len(did) or float(did.mean()) <= LIKE:
                continue
            colours = (old[:, can] / BIN).round()
            which = torch.unique(colours, dim=1, return_inverse=True)[1]
            often = torch.bincount(which, did) / torch.bincount(which)
            can[can.clone()] = often[which] > LIKE
        return could

    @cached_property
    def core(self) -> Where:
        """What is selected without its rim."""
        return ~_grown(~self.inside, BAND)


@dataclass(frozen=True)
class Signal:
    """One figure of an edit: how it is measured, and what is said and done beyond its limit."""

    measure: Callable[[Pictures], float | None]
    fault: str  # said with the figure as {} where it lies beyond the limit
    at_least: bool = False  # the limit is the least that is good, not the most
    in_scene: bool = False  # the scene tells of it too


def unchanged(found: Pictures) -> float | None:
    """Share of what can change that did not, though its like did; the worst photo counts.

    Its like: pixels of its own colour. The tyres of a bike that is painted stay black.
    """
    if found.removes:
        return None  # what was behind it may look like it
    if any(instruction.action == "other" for instruction in found.edit.instructions):
        # who puts a hat on a head leaves most of it as it was
        return None if bool((found.change >= SEEN).any()) else 1.0
    return _worst(
        float((could & (change < SEEN)).sum()) / int(can.sum())
        for could, change, can in zip(
            found.could_change, found.change, found.can_change
        )
        if int(can.sum()) >= FEW
    )


def outside(found: Pictures) -> float | None:
    """How much beside what is selected changed: in the photos all of it, in the scene the largest
    patch that changed like it. As a share of what is selected; the worst photo counts.
    """
    if not found.confined:
        return None
    shares = []
    for view, inside in enumerate(found.inside):
        area = int(inside.sum())
        if area < FEW:
            continue
        beside = ~_grown(found.touched[[view]], 1)[0]
        shares.append(float((beside & (found.change[view] >= SEEN)).sum()) / area)
        did = inside & (found.change[view] >= SEEN)
        wanted = (found.new - found.old)[view][:, did].mean(1)
        size = float(wanted.norm())
        if found.shown is None or found.removes or not size > 2 * CLEAR:
            continue  # a small change is like what scenes miss anyway
        moved = _blurred((found.shown - found.old)[view])
        along = (moved * wanted[:, None, None]).sum(0) / size
        across = (moved.square().sum(0) - along.square()).clamp(min=0).sqrt()
        like = (along > size / 2) & (across < along / 2)
        beside = ~_grown(found.touched[[view]], 2 * BAND)[0]
        shares.append(_largest(like & beside) / area)
    return _worst(shares)


def shared(found: Pictures) -> float | None:
    """Overlap of what is selected on two photos, on the surfaces that both show, in [0, 1].

    As far as outlines are sure: pixels within a rim of the other's outline agree. The mean of all
    pairs of photos.
    """
    edit = found.edit
    # where something was removed, the scene has no surface of it
    if (
        found.removes
        or edit.masks is None
        or edit.rendered is None
        or edit.cameras is None
    ):
        return None
    things = [one.masks[:, 0] for one in edit.selected] or [edit.masks[0]]
    masks = _small(torch.stack(things).amax(0))
    depths = _small(edit.rendered.depths[0, :, 0])
    cameras, overlaps = edit.cameras, []
    for first, second in permutations(range(len(masks)), 2):
        pair = [first, second]
        grid, same = shared_surface(
            depths[pair],
            cameras.intrinsics[0, pair],
            cameras.c2w[0, pair],
            SAME_SURFACE,
        )
        there = warp(masks[second, None], grid, padding="zeros")[0] > 0.5
        here, seen = masks[first] > 0.5, same > 0.5
        near = [_grown(one[None], BAND)[0] for one in (here, there)]
        agree = int((seen & here & near[1]).sum()) + int((seen & there & near[0]).sum())
        either = int((seen & here).sum()) + int((seen & there).sum())
        if either >= 2 * FEW:
            overlaps.append(agree / either)
    return float(np.mean(overlaps)) if overlaps else None


def as_asked(found: Pictures) -> float | None:
    """Share of the change that has the hue, the grey or the brightness that was asked for.

    By how much pixels changed, not by their number. The least of the instructions; None where
    nothing can be compared.
    """
    shares = []
    for number, instruction in enumerate(found.edit.instructions):
        where = found.inside & (found.change > SEEN) & _region(found, number)
        if int(where.sum()) < FEW:
            continue
        old, new = (one.movedim(1, -1)[where] for one in (found.old, found.new))
        size = (new - old).norm(dim=1)
        for change in instruction.changes:
            right = None
            if change.kind == "paint" and change.colour is not None:
                right = _has_hue(new, _lab_of(change.colour.rgb).to(new))
            elif change.kind == "greyscale":
                right = new[:, 1:].norm(dim=1) < GREY
            elif change.kind == "brightness":
                right = (new[:, 0] - old[:, 0]) * change.amount > 0
            if right is not None:
                shares.append(float((size * right).sum() / size.sum()))
    return min(shares, default=None)


def strength(found: Pictures) -> float | None:
    """How far colours went towards the one that was asked for; 1: as saturated as it.

    Of black and white how much of the colour is gone. The median over what could change; the least
    of the instructions; None of all else.
    """
    shares = []
    for number, instruction in enumerate(found.edit.instructions):
        where = found.core & (found.change > SEEN / 2) & _region(found, number)
        if int(where.sum()) < FEW:
            continue
        old, new = (one.movedim(1, -1)[where] for one in (found.old, found.new))
        for change in instruction.changes:
            goal = torch.zeros_like(new)
            if change.kind == "paint" and change.colour is not None:
                goal = _lab_of(change.colour.rgb).to(new).expand_as(new)
            elif change.kind != "greyscale":
                continue
            way, went = (goal - old)[:, 1:], (new - old)[:, 1:]
            far = way.norm(dim=1) > CLEAR
            if int(far.sum()) >= FEW:
                done = (way * went).sum(1) / way.square().sum(1).clamp(min=1)
                shares.append(float(done[far].median()))
    return min(shares, default=None)


def rim(found: Pictures) -> float | None:
    """Share of the rim of what is selected that stayed as it was beside what changed.

    Of what is removed only a rim counts that differs from what is around it. The worst photo.
    """
    if not found.confined:
        return None
    shares = []
    did = found.core & (found.change > SEEN)
    # of what lies next to a place most changed: a gleam that did is no painted thing
    most = 2 * _blurred(did.float()) > _blurred(found.core.float())
    beside = most & _grown(did, 2 * BAND)
    for view, inside in enumerate(found.inside):
        band = ~found.core[view] & beside[view] & found.could_change[view]
        if int(band.sum()) < FEW:
            continue
        still = band & (found.change[view] < SEEN)
        if found.removes:
            around = _mean_around(found.old[view], ~inside)
            still &= (found.old[view] - around).norm(dim=0) > CLEAR
        shares.append(float(still.sum() / band.sum()))
    return _worst(shares)


def shines_through(found: Pictures) -> float | None:
    """How much of what was removed still shows: likeness of its steps of light before and after.

    A correlation, at most 1; of the worst photo, where the scene is known also there.
    """
    if not found.removes:
        return None
    likeness = []
    for view, inside in enumerate(found.inside):
        if int(inside.sum()) < FEW:
            continue
        old = _steps(found.old[view, 0])[:, inside].flatten()
        for picture in (found.new, found.shown):
            if picture is not None:
                new = _steps(picture[view, 0])[:, inside].flatten()
                # of what is left, not how alike: a faint ghost shows, a new texture does not
                likeness.append(
                    float((old * new).sum() / old.square().sum().clamp(min=1e-6))
                )
    return _worst(likeness)


def missed(found: Pictures) -> float | None:
    """Largest patch of what changed in a photo that the scene shows as it was, as a share of all
    that changed there; or what is torn half-way between two photos. The worst place counts.
    """
    if found.shown is None:
        return None
    shares = list(_torn(found))
    for old, new, shown in zip(found.old, found.new, found.shown):
        wanted, got = new - old, shown - old
        changed = wanted.norm(dim=0) > SEEN
        if int(changed.sum()) < FEW:
            continue
        arrived, asked = (
            _blurred((wanted * got).sum(0, keepdim=True))[0],
            _blurred((wanted * wanted).sum(0, keepdim=True))[0],
        )
        shares.append(_largest(changed & (arrived < 0.4 * asked)) / int(changed.sum()))
    return _worst(shares)


def _torn(found: Pictures) -> Iterator[float]:
    """Of what is selected the share that looks, half-way between two photos, like neither of them.

    Each point that the scene shows there is looked up in both photos, in or out of sight: a thing
    that is torn shows what lies behind it, one that dissolves a mixture.
    """
    between = found.edit.half_way
    if between is None or not found.confined or found.edit.cameras is None:
        return
    depths = _small(between.rendered.depths[0, :, 0])
    shown = _lab(between.rendered.images[0])
    cameras = found.edit.cameras
    for number, pair in enumerate(between.pairs):
        if not {*pair} <= {*found.views}:
            continue
        one = [number]
        lens, pose = between.cameras.intrinsics[0, one], between.cameras.c2w[0, one]
        points = unproject(depths[one], lens, pose).flatten(1, 2)
        thing = torch.zeros_like(depths[number], dtype=torch.bool)
        alike = thing.clone()
        for view in pair:
            lens, pose = cameras.intrinsics[0, [view]], cameras.c2w[0, [view]]
            places, away = project(points, lens, pose)
            grid = (2 * places - 1).view(1, *thing.shape, 2)
            there = (grid[0].abs() < 1).all(-1) & (away.view_as(thing) > 0)
            at = found.views.index(view)
            picture = torch.cat((_blurred(found.new[at]), found.inside[[at]].float()))
            seen = F.grid_sample(picture[None], grid, align_corners=False)[0]
            thing |= there & (seen[3] > 0.5)
            alike |= there & ((_blurred(shown[number]) - seen[:3]).norm(dim=0) < CLEAR)
        if int(thing.sum()) >= FEW:
            yield float((thing & ~alike).sum() / thing.sum())


SIGNALS = {
    "unchanged": Signal(
        unchanged,
        "a part ({:.0%}) of what was selected did not change ('all of it' changes that too)",
    ),
    "outside": Signal(
        outside,
        "it spread beyond what was selected, by {:.0%} of it (--mask holds it in)",
        in_scene=True,
    ),
    "shared": Signal(
        shared,
        "it lies at different places in the photos, which share {:.0%} of it (mark it on each: "
        "--point N:X,Y)",
        at_least=True,
        in_scene=True,
    ),
    "as_asked": Signal(
        as_asked,
        "only {:.0%} of the change looks as asked (another --editor may do it)",
        at_least=True,
    ),
    "strength": Signal(
        strength,
        "it is too faint, {:.0%} of what was asked (ask again with --from this run)",
        at_least=True,
    ),
    "rim": Signal(
        rim,
        "a rim of the old colours is left along {:.0%} of the outline (--grow 2 takes it too)",
    ),
    "shines_through": Signal(
        shines_through,
        "what was removed shines through, {:.0%} of it (--grow 4 takes more around it)",
        in_scene=True,
    ),
    "missed": Signal(
        missed,
        "a part ({:.0%}) of it is missing or torn in the 3D scene (a photo from between helps)",
        in_scene=True,
    ),
}
"""All are shares, of 1; said in percent."""


def measured(edit: EditToJudge) -> dict[str, float | None]:
    """All signals of an edit; what the photos alone tell is taken over from the verdict in 2D."""
    found = Pictures(edit)
    known = {} if edit.in_2d is None else edit.in_2d.measures
    return {
        name: known[name] if name in known and not one.in_scene else one.measure(found)
        for name, one in SIGNALS.items()
    }


def _worst(values: Iterable[float]) -> float | None:
    return max(values, default=None)


def _region(found: Pictures, number: int) -> Where:
    """Where an instruction applies."""
    if found.edit.regions is None:
        return torch.ones_like(found.inside)
    return _small(found.edit.regions[number, 0, found.views]) > 0.5


def _small(maps: Float[Tensor, "*batch height width"]) -> Float[Tensor, "*batch h w"]:
    """Maps with `SIDE` pixels on the longer side, at most."""
    height, width = maps.shape[-2:]
    scale = min(1.0, SIDE / max(height, width))
    size = (round(scale * height), round(scale * width))
    flat = maps.reshape(-1, 1, height, width)
    return F.adaptive_avg_pool2d(flat, size).view(*maps.shape[:-2], *size)


def _lab(images: Float[Tensor, "view 3 height width"]) -> Float[Tensor, "view 3 h w"]:
    return rgb_to_lab(_small(images).clamp(0, 1))


def _lab_of(rgb: tuple[float, float, float]) -> Float[Tensor, "3"]:
    return rgb_to_lab(torch.tensor(rgb)[:, None, None])[:, 0, 0]


def _has_hue(
    colours: Float[Tensor, "pixel 3"], wanted: Float[Tensor, "3"]
) -> Bool[Tensor, "pixel"]:
    """Whether each has the hue of a colour, or is as grey as it."""
    if float(wanted[1:].norm()) < 2 * GREY:
        return colours[:, 1:].norm(dim=1) < 2 * GREY
    apart = torch.atan2(colours[:, 2], colours[:, 1]) - torch.atan2(
        wanted[2], wanted[1]
    )
    return torch.rad2deg(torch.atan2(apart.sin(), apart.cos()).abs()) < HUE


def _grown(where: Where, pixels: int) -> Where:
    return torch.stack([dilate(one.float(), pixels) > 0 for one in where])


def _blurred(
    maps: Float[Tensor, "channel height width"],
) -> Float[Tensor, "channel height width"]:
    """Over two pixels: scenes are softer than photos."""
    return torch.stack(
        [
            torch.from_numpy(cv2.GaussianBlur(one.numpy(force=True), (0, 0), 2.0)).to(
                one
            )
            for one in maps
        ]
    )


def _mean_around(
    picture: Float[Tensor, "channel height width"], where: Bool[Tensor, "height width"]
) -> Float[Tensor, "channel height width"]:
    """The mean colour about each pixel of what lies in `where`."""
    weight = _blurred(where[None].float())
    return _blurred(picture * where) / weight.clamp(min=1e-3)


def _steps(light: Float[Tensor, "height width"]) -> Float[Tensor, "2 height width"]:
    """How light changes to the right and downwards, over two pixels."""
    smooth = cv2.GaussianBlur(light.numpy(force=True), (0, 0), 1.0)
    steps = [cv2.Sobel(smooth, cv2.CV_32F, *way) for way in ((1, 0), (0, 1))]
    return torch.from_numpy(np.stack(steps)).to(light)


def _largest(where: Bool[Tensor, "height width"]) -> int:
    """Pixels of the largest connected patch, without hairs of it."""
    thick = cv2.morphologyEx(
        where.numpy(force=True).astype(np.uint8),
        cv2.MORPH_OPEN,
        np.ones((3, 3), np.uint8),
    )
    areas = cv2.connectedComponentsWithStats(thick)[2][1:, cv2.CC_STAT_AREA]
    return int(areas.max(initial=0))
