"""What tells how an edit was carried out on what was selected: nine signals, each a figure with a
meaning, none of which knows what a person meant.

A signal is None where it cannot be told. Its limit stands in `limits.yaml`, beyond which the edit
is doubtful; `benchmarks/fit_verdict.py` chooses it by edits made well and badly on purpose.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
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

from edit3r.contract.interfaces import EditToJudge, HalfWay, SceneToJudge
from edit3r.contract.types import Cameras
from edit3r.kit.compute.colour import linear_to_srgb, rgb_to_lab, srgb_to_linear
from edit3r.kit.files.configs import read_yaml
from edit3r.kit.geometry.cameras import pixel_grid, project, unproject
from edit3r.kit.geometry.maps import dilate, resize, size_of
from edit3r.kit.geometry.warping import SAME_SURFACE, shared_surface, warp

# The numbers of this block: docs/notes/verdict.md.
FITTED = Path(__file__).with_name("limits.yaml")
SIDE = 256  # longer side at which pictures are looked at [pixels]
SEEN = 6.0  # difference of colours that one sees [CIE Lab]
CLEAR = 12.0  # difference of colours that nobody overlooks [CIE Lab]
BAND = 3  # pixels about an outline: its rim, and what blurs across it
WIDE = 12  # pixels over which detail is told, and about what was removed, for its place
BIN = 10.0  # difference within which colours are one [CIE Lab]
LIKE = 0.1  # share of a colour that changed, from which all of it could
FEW = 30  # pixels below which nothing is told
MOTION_SAMPLES = 2000  # pixels that tell how a whole picture moves, about; by hand
MOTION_LIMIT = 8.0  # that they may lie off it [pixels]; by hand

Maps = Float[Tensor, "view height width"]
Where = Bool[Tensor, "view height width"]
Picture = Float[Tensor, "channel height width"]
RGB = tuple[float, float, float]  # sRGB in [0, 1]


@cache
def fitted_limits(of: str) -> Mapping[str, Any]:
    """Of an "edit" by signal, of a "scene" by label and signal."""
    return read_yaml(FITTED)[of]


class Pictures:
    """An edit's photos before and after, and the scene from their places, as signals see them."""

    def __init__(self, edit: EditToJudge) -> None:
        views = list(edit.edited)
        self.edit, self.views = edit, views
        self.old, self.new = (
            lab(one.images[0, views]) for one in (edit.before, edit.after)
        )
        drawn = edit.rendered
        self.shown = None if drawn is None else lab(drawn.images[0, views])
        self.change = (self.new - self.old).norm(dim=1)
        masks = torch.ones_like(self.change)
        if edit.masks is not None:
            masks = small(edit.masks[0, views])
        self.inside = masks > 0.5
        self.touched = masks > 0.02  # soft edges may change a little
        self.core = ~_grown(~self.inside, BAND)  # without its rim
        self.confined = not bool(self.inside.all())
        self.actions = {one.action for one in edit.instructions}
        self.removes = "remove" in self.actions
        self.asked = [
            (number, change)
            for number, instruction in enumerate(edit.instructions)
            for change in instruction.changes
        ]
        self.kinds = {change.kind for _, change in self.asked}

    @cached_property
    def can_change(self) -> Where:
        """What is selected and does not look as asked already: grey has no colour to lose."""
        can = self.inside
        if self.kinds == {"greyscale"}:
            return can & (self.old[:, 1:].norm(dim=1) > SEEN)
        for _, change in self.asked if self.kinds == {"paint"} else ():
            if change.colour is not None and bool(self.inside.any()):
                off = self.old - _lab_of(change.colour.rgb)[:, None, None]
                # paint keeps light and shade
                off[:, 0] = off[:, 0][self.inside].median()
                can = can & (off.norm(dim=1) > 2 * CLEAR)
        return can

    @cached_property
    def could_change(self) -> Where:
        """What can change, and has a colour of which some did, or of whose neighbours; all of it
        where nothing did. The tyres of a bike that is painted stay black.
        """
        could = self.can_change.clone()
        if self.kinds == {"greyscale"}:
            return could  # of everything
        reach = 0.0 if "brightness" in self.kinds else 1.5  # dark ones change less
        for old, change, can in zip(self.old, self.change, could):
            did = (change[can] >= SEEN).float()
            if not len(did) or float(did.mean()) <= LIKE:
                continue
            colours = (old[:, can] / BIN).round()
            colours, which = torch.unique(colours, dim=1, return_inverse=True)
            near = (torch.cdist(colours.T, colours.T) <= reach).float()
            often = (near @ torch.bincount(which, did)) / (
                near @ torch.bincount(which).float()
            )
            can[can.clone()] = often[which] > LIKE
        return could


Measure = Callable[[Pictures], float | None]


@dataclass(frozen=True)
class Signal:
    """One figure of an edit: how it is measured, and what is said and done beyond its limit."""

    measure: Measure
    fault: str  # said with the figure as {} where it lies beyond the limit
    at_least: bool = False  # the limit is the least that is good, not the most
    in_scene: bool = False  # the scene tells of it too


SIGNALS: dict[str, Signal] = {}
"""All are shares, of 1; said in percent."""


def signal(fault: str, **how: bool) -> Callable[[Measure], Measure]:
    """Makes a signal of a figure, by the name of its function."""

    def added(measure: Measure) -> Measure:
        SIGNALS[measure.__name__] = Signal(measure, fault, **how)
        return measure

    return added


@signal(
    "a part ({:.0%}) of what was selected did not change ('all of it' changes that too)"
)
def unchanged(found: Pictures) -> float | None:
    """Share of what can change that did not, though its like did; the worst photo counts."""
    if found.removes:
        return None  # what was behind it may look like it
    if "other" in found.actions:
        # who puts a hat on a head leaves most of it as it was
        return None if bool((found.change >= SEEN).any()) else 1.0
    shares = [
        float((could & (change < SEEN)).sum()) / int(can.sum())
        for could, change, can in zip(
            found.could_change, found.change, found.can_change
        )
        if int(can.sum()) >= FEW
    ]
    return max(shares, default=None)


@signal("it spread beyond what was selected, by {:.0%} of it (--mask holds it in)")
def outside(found: Pictures) -> float | None:
    """How much beside what is selected changed, as a share of what is selected; the worst photo."""
    if not found.confined:
        return None
    changed = ~_grown(found.touched, 1) & (found.change >= SEEN)
    shares = [
        float(beside.sum()) / int(inside.sum())
        for beside, inside in zip(changed, found.inside)
        if int(inside.sum()) >= FEW
    ]
    return max(shares, default=None)


@signal(
    "it lies at different places in the photos, which share {:.0%} of it (mark it on each: "
    "--point N:X,Y)",
    at_least=True,
    in_scene=True,
)
def shared(found: Pictures) -> float | None:
    """Overlap of what is selected on two photos, on the surfaces that both show, in [0, 1].

    As far as outlines are sure: pixels within a rim of the other's outline agree. The mean of all
    pairs of photos.
    """
    edit, cameras = found.edit, found.edit.cameras
    # where something was removed, the scene has no surface of it
    if found.removes or edit.masks is None or edit.rendered is None or cameras is None:
        return None
    things = [one.masks[:, 0] for one in edit.selected] or [edit.masks[0]]
    masks, overlaps = small(torch.stack(things).amax(0)), []
    for (view, _), seen, there in _laid_over(edit, masks, range(len(masks))):
        both = torch.stack((masks[view] > 0.5, there))
        either = int((seen & both).sum())
        if either >= 2 * FEW:
            agreed = seen & both & _grown(both.flip(0), BAND)
            overlaps.append(int(agreed.sum()) / either)
    return float(np.mean(overlaps)) if overlaps else None


@signal(
    "it went only {:.0%} of the way to what was asked (ask again with --from this run, or "
    "another --editor)",
    at_least=True,
)
def as_asked(found: Pictures) -> float | None:
    """How far what changed came to what was asked for: 1: all the way, 0 or less: elsewhere.

    To a colour, or to black and white: in hue and saturation, but for what nobody sees, the median;
    what is darker than the colour cannot have all of its saturation; what had the colour and has it
    still is all the way. Of brightness the share of the change that
    has the right sign. The least of the changes; None where nothing tells.
    """
    shares = []
    for number, change in found.asked:
        where = found.inside & (found.change > SEEN / 2) & _region(found, number)
        if int(where.sum()) < FEW:
            continue
        old, new = (one.movedim(1, -1)[where] for one in (found.old, found.new))
        if change.kind == "brightness":
            size, lighter = (new - old).norm(dim=1), (new - old)[:, 0]
            shares.append(float(size[lighter * change.amount > 0].sum() / size.sum()))
        elif change.kind == "greyscale" or (change.kind == "paint" and change.colour):
            paint = change.colour.rgb if change.colour else (0.0, 0.0, 0.0)
            goal = _goal(paint, new[:, 0])
            before, left = ((goal - one[:, 1:]).norm(dim=1) for one in (old, new))
            share = 1 - (left - SEEN).clamp(min=0) / before.clamp(min=CLEAR)
            share[_painted(old, paint) & _painted(new, paint)] = 1
            shares.append(float(share.median()))
    return min(shares, default=None)


@signal(
    "a rim of the old colours is left along {:.0%} of the outline (--grow 2 takes it too)"
)
def rim(found: Pictures) -> float | None:
    """Share of the rim of what is selected that stayed as it was, though the change beside it is
    clear to see; of what is removed, though it differs clearly from what is around it. The worst
    photo.
    """
    if not found.confined:
        return None
    shares = []
    did = found.core & (found.change > SEEN)
    beside = _grown(did, 2 * BAND)
    for view, inside in enumerate(found.inside):
        band = ~found.core[view] & beside[view] & found.could_change[view]
        if int(band.sum()) < FEW:
            continue
        if found.removes:
            lacks = _mean_around(found.old[view], ~inside) - found.old[view]
        else:
            lacks = _mean_around((found.new - found.old)[view], did[view])
        left = band & (found.change[view] < SEEN) & (lacks.norm(dim=0) > CLEAR)
        shares.append(float(left.sum() / band.sum()))
    return max(shares, default=None)


@signal(
    "what was removed shines through, or left a blur: its place is only {:.0%} like what is around "
    "it (--grow 4 takes more around it; another --editor may fill it better)",
    at_least=True,
    in_scene=True,
)
def closed(found: Pictures) -> float | None:
    """How well the place of what was removed is closed: 1 where none of its steps of light is left
    (in the scene, where that is known) and the photo has half of the detail there that is around
    it: what is filled in is softer, and a large smear has none. The worst photo.
    """
    if not found.removes:
        return None
    now = found.new if found.shown is None else found.shown
    shares = []
    around = _grown(found.inside, WIDE) & ~_grown(found.inside, BAND)
    fine = (found.new - blurred(found.new))[:, 0].abs() + 0.01  # flat walls have none
    told = blurred(fine, WIDE)
    for view, (inside, beside) in enumerate(zip(found.inside, around)):
        if min(int(inside.sum()), int(beside.sum())) < FEW:
            continue
        old, new = (_steps(one[view, 0])[:, inside] for one in (found.old, now))
        # of what is left, not how alike: a faint ghost shows, a new texture does not
        left = (old * new).sum() / old.square().sum().clamp(min=1e-6)
        detail = told[view][inside].median() / fine[view][beside].mean()
        shares.append(min(1 - float(left), 2 * float(detail), 1.0))
    return min(shares, default=None)


@signal(
    "what stands in its place is a guess: it was large, and no photo shows what was behind it "
    "(photos that do, a smaller part, or another --editor)",
    in_scene=True,
)
def invented(found: Pictures) -> float | None:
    """How hard it is to guess what was behind what is removed: how varied its surroundings are (a
    share of the range of CIE Lab), times how far the middle of what no other photo shows lies from
    what one does (a share of the longer side). The worst photo counts.
    """
    if not found.removes or found.shown is None:
        return None
    figures = []
    around = _grown(found.inside, WIDE) & ~_grown(found.inside, BAND)
    coarse = blurred(found.old, WIDE / 2) / 100
    for colours, hidden, beside in zip(coarse, _nowhere_shown(found), around):
        if min(int(hidden.sum()), int(beside.sum())) < FEW:
            continue
        varied = colours[:, beside].var(1).sum().sqrt()
        middle = cv2.distanceTransform(hidden.byte().numpy(), cv2.DIST_L2, 5).max()
        figures.append(float(varied) * float(middle) / max(hidden.shape))
    return max(figures, default=None)


@signal(
    "a part ({:.0%}) of it is missing in the 3D scene (a photo from between helps)",
    in_scene=True,
)
def missed(found: Pictures) -> float | None:
    """Share of what changed in a photo that the scene shows as it was; the worst photo counts."""
    if found.shown is None:
        return None
    shares = []
    for old, new, shown in zip(found.old, found.new, found.shown):
        wanted, got = new - old, shown - old
        changed = wanted.norm(dim=0) > SEEN
        if int(changed.sum()) >= FEW:
            arrived, asked = blurred(
                torch.stack([wanted * got, wanted * wanted]).sum(1)
            )
            lost = changed & (arrived < 0.4 * asked)
            shares.append(float(lost.sum() / changed.sum()))
    return max(shares, default=None)


@signal(
    "it is torn or blurred half-way between the photos, by {:.0%} (a photo from between helps)",
    in_scene=True,
)
def torn(found: Pictures) -> float | None:
    """How much what is selected looks, half-way between two photos, like neither of them: 1 where
    its colours are off by twice what nobody overlooks; the worst place counts.
    """
    between = found.edit.half_way
    if between is None or not found.confined:
        return None
    photos, masks = (dict(zip(found.views, one)) for one in (found.new, found.inside))
    unlike = unlike_either(between, photos, masks, 2 * CLEAR, 1, found.edit.cameras)
    return max((share for _, share in unlike), default=None)


def measured(edit: EditToJudge) -> dict[str, float | None]:
    """All signals of an edit; what the photos alone tell is taken over from the verdict in 2D."""
    found = Pictures(edit)
    known = {} if edit.in_2d is None else edit.in_2d.measures
    return {
        name: known[name] if name in known and not one.in_scene else one.measure(found)
        for name, one in SIGNALS.items()
    }


def unlike_either(
    between: HalfWay,
    photos: Mapping[int, Picture],
    masks: Mapping[int, Bool[Tensor, "height width"]],
    wholly: float,
    soft: float,
    cameras: Cameras | None = None,
    side: int = SIDE,
) -> Iterator[tuple[tuple[int, int], float]]:
    """Pairs of photos, and how much of what is masked looks half-way like neither of the two: 1
    where colours are off by `wholly` [CIE Lab], over `soft` pixels of the longer `side`.

    Each pixel is compared where optical flow finds it in the photos: a thing that is torn or
    dissolved is found in none, one that lies a little aside is. `cameras` of the photos: flow
    begins with how the picture as a whole moves, since by itself it loses what moves far.
    """
    if between.photos is not None:  # a brighter one would look like another thing
        in_one_light = lab(between.photos.images[0], side)
        photos = {view: in_one_light[view] for view in photos}
    drawn = zip(between.pairs, between.rendered.images[0].cpu())
    for place, (pair, shown) in enumerate(drawn):
        if not {*pair} <= {*photos}:
            continue
        # Made smaller twice it may be off by a row.
        size = size_of(photos[pair[0]])
        if min(size) < FEW:
            continue
        (shown,) = rgb_to_lab(resize(shown[None], size).clamp(0, 1))
        thing, off = torch.zeros_like(shown[0]), torch.full_like(shown[0], torch.inf)
        for view in pair:
            start = None
            if cameras is not None:
                start = _motion(between, place, cameras, view, size_of(shown))
            picture = (blurred(photos[view], soft), masks[view][None].float())
            grid = _found_in(photos[view], shown, start)
            *colour, inside = warp(torch.cat(picture), grid)
            unlike = (blurred(shown, soft) - torch.stack(colour)).norm(dim=0)
            off, thing = torch.minimum(off, unlike), torch.maximum(thing, inside)
        if int((thing > 0.5).sum()) >= FEW:
            yield pair, float((off / wholly).clamp(max=1)[thing > 0.5].mean())


def unlike_between(
    scene: SceneToJudge,
    where: Bool[Tensor, "view h w"] | None = None,
    side: int = SIDE,
) -> list[float | None]:
    """For each placed photo how much of the view half-way to its nearest looks like neither, seen
    with `side` pixels on the longer side.

    `where`: of what the photos show there alone, of that size; None: everywhere.
    """
    photos = dict(enumerate(lab(scene.edited.images[0], side)))
    shares: list[float | None] = [None] * len(photos)
    if scene.half_way is not None:
        masks = {view: torch.ones_like(one[0]) > 0 for view, one in photos.items()}
        if where is not None:
            masks = dict(enumerate(where))
        unlike = unlike_either(scene.half_way, photos, masks, CLEAR, 2, side=side)
        for pair, share in unlike:
            for view in pair:
                shares[view] = max(shares[view] or 0.0, share)
    return shares


def faults_of(
    figures: Mapping[str, float | None], limits: Mapping[str, float]
) -> dict[str, str]:
    """What is said of each signal that lies beyond its limit, by its name."""
    found = {}
    for name, signal in SIGNALS.items():
        sign, figure = -1 if signal.at_least else 1, figures[name]
        if figure is not None and sign * figure > sign * limits[name]:
            found[name] = signal.fault.format(max(figure, 0.0))
    return found


def _nowhere_shown(found: Pictures) -> Where:
    """What is selected, but for what another photo shows, as the scene's depths tell."""
    hidden = found.inside.clone()
    if found.edit.cameras is not None and found.edit.rendered is not None:
        masks = found.inside.float()
        for (view, _), seen, there in _laid_over(found.edit, masks, found.views):
            hidden[view] &= ~seen | there
    return hidden


def _laid_over(
    edit: EditToJudge, masks: Maps, views: Sequence[int]
) -> Iterator[tuple[tuple[int, int], Where, Where]]:
    """Of each two masks of `views`, by their number: which pixels of the first photo the second
    shows too, as the scene's depths tell, and which of them are masked there.
    """
    assert edit.cameras is not None and edit.rendered is not None
    used = list(views)
    depths = small(edit.rendered.depths[0, used, 0])
    lenses = edit.cameras.intrinsics[0, used].cpu()
    poses = edit.cameras.c2w[0, used].cpu()
    for first, second in permutations(range(len(masks)), 2):
        pair = [first, second]
        grid, seen = shared_surface(
            depths[pair], lenses[pair], poses[pair], SAME_SURFACE
        )
        there = warp(masks[second, None], grid, padding="zeros")[0] > 0.5
        yield (first, second), seen, there


def _region(found: Pictures, number: int) -> Where:
    """Where an instruction applies."""
    if found.edit.regions is None:
        return torch.ones_like(found.inside)
    return small(found.edit.regions[number, 0, found.views]) > 0.5


def small(
    maps: Float[Tensor, "*batch height width"], side: int = SIDE
) -> Float[Tensor, "*batch h w"]:
    """Maps with `side` pixels on the longer side, at most, on the CPU."""
    height, width = maps.shape[-2:]
    scale = min(1.0, side / max(height, width))
    size = (round(scale * height), round(scale * width))
    flat = maps.reshape(-1, 1, height, width).cpu()
    return F.adaptive_avg_pool2d(flat, size).view(*maps.shape[:-2], *size)


def lab(
    images: Float[Tensor, "view 3 height width"], side: int = SIDE
) -> Float[Tensor, "view 3 h w"]:
    """In CIE Lab, `side` pixels at most."""
    return rgb_to_lab(small(images, side).clamp(0, 1))


def _lab_of(rgb: tuple[float, float, float]) -> Float[Tensor, "3"]:
    return rgb_to_lab(torch.tensor(rgb)[:, None, None])[:, 0, 0]


def _painted(pixels: Float[Tensor, "pixel 3"], paint: RGB) -> Tensor:
    """Which pixels have a paint's hue and saturation, in whatever light [bool]."""
    goal = _in_light(paint, pixels[:, 0])
    return (pixels[:, 1:] - goal).norm(dim=1) < goal.norm(dim=1) / 4


def _goal(paint: RGB, lightness: Float[Tensor, "pixel"]) -> Float[Tensor, "pixel 2"]:
    """The hue and saturation that pixels can take of a paint: all of it, less where it is dark."""
    whole = _lab_of(paint)
    dark = (lightness < whole[0])[:, None]
    return torch.where(dark, _in_light(paint, lightness), whole[1:])


def _in_light(
    paint: RGB, lightness: Float[Tensor, "pixel"]
) -> Float[Tensor, "pixel 2"]:
    """Hue and saturation (a, b) of a paint in the light in which it is so light."""
    light = 8 * torch.linspace(0, 1, 257) ** 2
    lit = (srgb_to_linear(torch.tensor(paint))[:, None] * light).clamp(max=1)
    shades = rgb_to_lab(linear_to_srgb(lit)[:, None])[:, 0]
    shade = torch.searchsorted(shades[0], lightness.contiguous()).clamp(max=256)
    return shades[1:, shade].T


def _grown(where: Where, pixels: int) -> Where:
    return torch.stack([dilate(one.float(), pixels) > 0 for one in where])


def blurred(maps: Tensor, pixels: float = 2) -> Tensor:
    """Over two pixels: scenes are softer than photos."""
    flat = maps.reshape(-1, *maps.shape[-2:]).numpy()
    smooth = [cv2.GaussianBlur(one, (0, 0), pixels) for one in flat]
    return torch.from_numpy(np.stack(smooth)).view(maps.shape)


def _found_in(
    picture: Picture, other: Picture, start: np.ndarray | None
) -> Float[Tensor, "height width 2"]:
    """Where in a picture each pixel of the other lies, normalised: DIS, Kroeger et al. 2016, from
    the flow `start` [pixels] on.
    """
    light = [(2.55 * one[0]).byte().numpy() for one in (other, picture)]
    engine = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    flow = torch.from_numpy(engine.calc(*light, start))  # type: ignore[call-overload]
    size = size_of(picture)
    return pixel_grid(size, flow) + flow / flow.new_tensor(size[::-1])


def _motion(
    between: HalfWay, place: int, cameras: Cameras, view: int, size: tuple[int, int]
) -> Float[np.ndarray, "height width 2"] | None:
    """Flow of the whole picture from half-way into a photo [pixels], by the homography that is
    nearest to the scene's depths: of what is torn or dissolved it knows nothing. None: there is
    none.
    """
    eye, depths = between.cameras, between.rendered.depths[:, [place], 0]
    points = unproject(depths, eye.intrinsics[:, [place]], eye.c2w[:, [place]])
    there, z = project(
        points.flatten(1, 3), cameras.intrinsics[:, view], cameras.c2w[:, view]
    )
    shown = between.rendered.alphas[0, place, 0].flatten() > 0.5
    kept = shown & (z[0] > 0) & (there[0] > -1).all(-1) & (there[0] < 2).all(-1)
    if int(kept.sum()) < FEW:
        return None
    sides = torch.tensor(size[::-1], dtype=torch.float64)
    here = pixel_grid(size_of(depths), depths).flatten(0, 1)
    step = len(here) // MOTION_SAMPLES + 1
    first, second = (
        (one[kept][::step].cpu() * sides).numpy() for one in (here, there[0])
    )
    cv2.setRNGSeed(0)
    matrix, _ = cv2.findHomography(first, second, cv2.RANSAC, MOTION_LIMIT)
    if matrix is None:
        return None
    moved = homography_grid(matrix, size) - pixel_grid(size, sides)
    flow = (moved * sides).float().numpy()
    return flow if np.abs(flow).max() < 2 * max(size) else None


def homography_grid(
    matrix: np.ndarray, size: tuple[int, int]
) -> Float[Tensor, "height width 2"]:
    """Where a homography of pixels brings each pixel, normalised; in float64."""
    sides = torch.tensor(size[::-1], dtype=torch.float64)
    pixels = pixel_grid(size, sides) * sides
    ones = torch.ones_like(pixels[..., :1])
    moved = torch.cat((pixels, ones), -1) @ torch.from_numpy(matrix).T
    return moved[..., :2] / moved[..., 2:] / sides


def _mean_around(picture: Picture, where: Bool[Tensor, "height width"]) -> Picture:
    """The mean colour about each pixel of what lies in `where`."""
    weight = blurred(where[None].float())
    return blurred(picture * where) / weight.clamp(min=1e-3)


def _steps(light: Float[Tensor, "height width"]) -> Float[Tensor, "2 height width"]:
    """How light changes to the right and downwards, over two pixels."""
    smooth = cv2.GaussianBlur(light.numpy(), (0, 0), 1.0)
    steps = [cv2.Sobel(smooth, cv2.CV_32F, *way) for way in ((1, 0), (0, 1))]
    return torch.from_numpy(np.stack(steps))
