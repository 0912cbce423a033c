"""Paint: a thing's own paint takes another colour; what is neutral on it stays, and so does light.

In OKLab a shadow scales lightness and chroma alike, so that saturation, which is chroma over
lightness, tells paint from rubber, chrome and glass in light and shade. The paint is measured once
over all photos of a scene. Each pixel is then changed by its own colour alone: one surface gets one
colour in every view.
"""

import math
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.reporting import say
from edit3r_recolor.oklab import oklab_to_rgb, rgb_to_oklab

Images = Float[Tensor, "view 3 height width"]
Masks = Float[Tensor, "view height width"]
Pixels = Float[Tensor, "3 1 pixel"]  # OKLab
Weights = Float[Tensor, "1 pixel"]
Goal = Float[Tensor, "3 1 1"]  # OKLab of the asked colour

# The numbers of this block: no figures kept.
NEUTRAL_CHROMA = 0.02  # a pixel below has no hue
DARK = 0.2  # lightness below which saturation is mostly noise
PART_PAINT, ALL_PAINT = 0.35, 0.5  # shares of the paint's saturation
VIVID = 0.18  # saturation that no stone, fur, skin or leaf has
FAINT = 0.05  # saturation below which a thing is grey or white
MIN_SHARE = 0.12  # of the thing, for a colour on it to be its paint
MIN_COLOUR = 0.4  # share of all chroma on the thing that its paint has
MAX_BETWEEN = 0.2  # share of the paint that may be half neutral, where it is not vivid
LIGHTNESS = (0.2, 0.86)  # of the blackest and the whitest paint: shading needs room
MAX_SLOPE = 1.2  # of new lightness over old
MATTE_SLOPE = 0.3  # the same above the paint's lightness, where highlights are
COMPARED_STEP = 0.08  # of lightness, that "darker" is darker than before
MAX_BEND = 3.0  # slope on one side of the paint's lightness over that on the other
METAL_CONTRAST = 2.0  # slope of new lightness over old in the middle
DARKEST, BRIGHTEST = 0.08, 0.98  # lightness of metal
MOSTLY = 0.85  # share of the thing from which a paint that is not vivid is all of it
ELSEWHERE = 0.25  # by eye: of the largest share that a paint has on one photo
MAX_BORDER = 4.5  # length of the border of the paint on a thing [sides of the thing]
BORDER_SIDE = 256  # pixels of the longer side at which that is measured
HUE_BINS = 72
HUE_FALL = 0.5  # of the tolerance, over which membership falls to 0
# What steps of 8 bits and compression move the chroma of a pixel by, and lightness at which that no
# longer counts and at which it counts fully: the hue of dark fur is mostly noise
DARK_NOISE, NOISE_FADES = 0.015, (0.35, 0.25)


@dataclass(frozen=True)
class Paint:
    """The own colour of a thing."""

    hue: float  # [radians]
    saturation: float  # 0: no clear paint, so all of the thing is painted
    lightness: float  # median
    tolerance: float  # largest difference in hue that is wholly this paint [degrees]

    @property
    def is_clear(self) -> bool:
        """Whether the thing has a paint of its own, apart from the rest of it."""
        return self.saturation != 0

    @property
    def may_be_natural(self) -> bool:
        """Whether stone, fur, skin or leaves may have this colour."""
        return 0 < self.saturation < VIVID


def paint(
    images: Images,
    region: Masks,
    rgb: tuple[float, float, float],
    tolerance: float = 18,
    flood: bool = False,
    metal: bool = False,
    matte: bool = False,
    than_now: int = 0,
) -> Images:
    """Give the paint of the thing under `region` (in [0, 1]) the sRGB colour `rgb` in [0, 1].

    Shading and highlights stay. A thing without a clear colour is painted whole, and so is one that
    would change in islands; any thing is where `flood` is set. `tolerance` is how far hues of one
    paint are apart [degrees]. `metal` gives it the contrast and the coloured highlights of polished
    metal, `matte` weaker highlights, and `than_now` a colour that is darker (-1) or lighter (1)
    than what it was.
    """
    inside = region > 0
    if not inside.any():
        return images
    old = images.movedim(1, 0)[:, inside][:, None]
    weights = region[inside][None]
    lab = rgb_to_oklab(old)
    goal = rgb_to_oklab(old.new_tensor(rgb)[:, None, None])
    own = own_paint(lab, weights, tolerance, flood)
    goal = _compared(goal, own, than_now)
    own, member = _all_or_part(own, lab, weights, region)
    touched = member[0] > 0
    new = repainted(lab[..., touched], own, goal, metal, matte)
    weight = member[:, touched]
    old[..., touched] = torch.lerp(old[..., touched], oklab_to_rgb(new), weight)
    painted = images.clone()
    painted.movedim(1, 0)[:, inside] = old[:, 0]
    return painted


def _all_or_part(
    own: Paint, lab: Pixels, weights: Weights, region: Masks
) -> tuple[Paint, Weights]:
    """The paint that is changed and how much of it each pixel inside has; says which it is.

    All of the thing, where another side of it has another colour, or its colour may be natural and
    is on most of it or in islands.
    """
    member = membership(lab, own)
    share = float((weights * member).sum() / weights.sum())
    placed = _placed(member, region > 0)
    natural = own.may_be_natural and (share >= MOSTLY or _is_in_islands(placed, region))
    if natural or (own.is_clear and _is_elsewhere(placed, region)):
        say(
            "paint",
            f"{share:.0%} of the thing has one colour, and no clear parts: all of it is painted",
        )
        own = own_paint(lab, weights, own.tolerance, flood=True)
        return own, membership(lab, own)
    if own.is_clear:
        say(
            "paint",
            f"{share:.0%} of the thing has its main colour and is painted; say 'all of it' to "
            "paint the rest too",
        )
    return own, member


def _placed(values: Weights, inside: Bool[Tensor, "view height width"]) -> Masks:
    """Numbers of the pixels inside, put back in their places; 0 elsewhere."""
    places = values.new_zeros(inside.shape)
    places[inside] = values[0]
    return places


def _is_elsewhere(member: Masks, region: Masks) -> bool:
    """Whether a photo of the thing shows hardly any of a paint: that of its other side."""
    area = region.sum((1, 2))
    share = (region * member).sum((1, 2)) / area.clamp(min=1e-9)
    shows = area > ELSEWHERE * area.max()
    return float(share[shows].min()) < ELSEWHERE * float(share.max())


def _is_in_islands(member: Masks, region: Masks) -> bool:
    """Whether a paint lies on a part of the thing in many pieces.

    Bark, bricks and fur have a colour that comes and goes; the parts of a made thing have theirs
    with short borders.
    """
    small = [_reduced(one).double() for one in (member, region)]
    painted, thing = (one > 0.5 for one in small)
    inner = -F.max_pool2d(-thing.double()[:, None], 5, 1, 2)[:, 0] > 0
    wider = F.max_pool2d(painted.double()[:, None], 3, 1, 1)[:, 0] > 0
    border = (wider & ~painted & inner).sum((1, 2))
    length = border / thing.sum((1, 2)).clamp(min=1).sqrt()
    return float(length[thing.any(2).any(1)].mean()) > MAX_BORDER


def _reduced(masks: Masks) -> Masks:
    """The masks with BORDER_SIDE pixels on the longer side, at most: a border is as long there."""
    height, width = masks.shape[-2:]
    scale = min(1.0, BORDER_SIDE / max(height, width))
    size = (max(1, round(scale * height)), max(1, round(scale * width)))
    return F.adaptive_avg_pool2d(masks[:, None], size)[:, 0]


def own_paint(lab: Pixels, weights: Weights, tolerance: float, flood: bool) -> Paint:
    """The commonest hue, weighted by chroma, with its saturation and lightness."""
    all_of_it = Paint(0, 0, _median(lab, weights), tolerance)
    if flood:
        return all_of_it
    chroma = _chroma(lab)
    coloured = weights * (chroma - NEUTRAL_CHROMA).clamp(min=0)
    commonest = replace(all_of_it, hue=_commonest_hue(lab, coloured, tolerance))
    near_hue = _near_hue(lab, commonest)
    near = weights * near_hue
    saturation = chroma / lab[0].clamp(min=DARK)
    cubes, squares = ((near * saturation**power).sum() for power in (3, 2))
    mean_saturation = cubes / squares.clamp(min=1e-9)
    commonest = replace(commonest, saturation=float(mean_saturation))
    member = membership(lab, commonest)
    painted = (weights * member).sum()
    share = float(painted / weights.sum())
    between = (weights * 4 * member * (1 - member)).sum() / painted.clamp(min=1e-9)
    apart = commonest.saturation >= VIVID or float(between) <= MAX_BETWEEN
    one_colour = (coloured * near_hue).sum() >= MIN_COLOUR * coloured.sum()
    clear = share >= MIN_SHARE and commonest.saturation >= FAINT
    if not (clear and apart and one_colour):
        return all_of_it
    return replace(commonest, lightness=_median(lab, weights * member))


def membership(lab: Pixels, own: Paint) -> Weights:
    """How much each pixel is of the paint, in [0, 1], by saturation and hue."""
    if not own.is_clear:
        return torch.ones_like(lab[0])
    share = _saturation(lab, own) / own.saturation
    coloured = ((share - PART_PAINT) / (ALL_PAINT - PART_PAINT)).clamp(0, 1)
    return coloured * _near_hue(lab, own)


def _compared(goal: Goal, own: Paint, than_now: int) -> Goal:
    """The colour moved to a lightness on the side of the thing's own that was asked for."""
    if not than_now:
        return goal
    limit = own.lightness + than_now * COMPARED_STEP
    asked = float(goal[0])
    lightness = min(asked, limit) if than_now < 0 else max(asked, limit)
    lightness = min(max(lightness, LIGHTNESS[0]), LIGHTNESS[1])
    chroma = min(1.0, lightness / max(asked, DARK))
    return torch.cat((torch.full_like(goal[:1], lightness), chroma * goal[1:]))


def repainted(
    lab: Pixels, own: Paint, goal: Goal, metal: bool = False, matte: bool = False
) -> Pixels:
    """The pixels as if all were painted: lightness moves to the goal's, chroma follows light.

    Chroma falls with lightness in shade, and fades to white in highlights, on metal later: its
    highlights have its colour.
    """
    end = min(max(float(goal[0]), LIGHTNESS[0]), LIGHTNESS[1])
    slope = MATTE_SLOPE if matte else MAX_SLOPE
    lightness = _polished(lab, own, end) if metal else _moved(lab, own, end, slope)
    shade = (lightness / end).clamp(max=1)
    shine = ((1 - lightness) / (1 - end)).clamp(0, 1)
    chroma = shade * (shine.sqrt() if metal else shine)
    if own.is_clear and not metal:
        chroma = chroma * (_saturation(lab, own) / own.saturation).clamp(max=1.1)
    return torch.cat((lightness[None], chroma * goal[1:]))


def _moved(lab: Pixels, own: Paint, end: float, up_slope: float = MAX_SLOPE) -> Weights:
    """Lightness by a line to either side of the paint's own, which becomes `end`."""
    start = min(max(own.lightness, 0.05), 0.95)
    up = min(up_slope, (1 - end) / (1 - start))
    down = min(MAX_SLOPE, end / start)
    up, down = min(up, MAX_BEND * down), min(down, MAX_BEND * up)
    beyond = lab[0] - start
    return end + up * beyond.clamp(min=0) + down * beyond.clamp(max=0)


def _polished(lab: Pixels, own: Paint, end: float) -> Weights:
    """Lightness of polished metal: dark shades and bright highlights, monotone in the old one."""
    beyond = METAL_CONTRAST * (lab[0] - own.lightness)
    room = torch.where(beyond > 0, BRIGHTEST - end, end - DARKEST)
    return end + room * torch.tanh(beyond / room)


def _median(lab: Pixels, weights: Weights) -> float:
    """The lightness that half of the pixels of much weight lie below."""
    return float(lab[0][weights >= weights.max() / 2].median())


def _commonest_hue(lab: Pixels, weights: Weights, tolerance: float) -> float:
    """The mean hue about the highest place of the smoothed histogram of hues [radians]."""
    bins = ((_hue(lab) / math.pi + 1) * HUE_BINS / 2).long() % HUE_BINS
    amounts = weights.flatten().double()
    counts = torch.bincount(bins.flatten(), amounts, minlength=HUE_BINS)
    shifts = (-1, 0, 1, 2)
    smooth = sum((counts.roll(shift) for shift in shifts), start=counts.roll(-2))
    peak = (int(smooth.argmax()) + 0.5) * 2 * math.pi / HUE_BINS - math.pi
    near = weights * _near_hue(lab, Paint(peak, 0, 0, tolerance / 2))
    y, x = ((near * part).sum() for part in (_hue(lab).sin(), _hue(lab).cos()))
    return math.atan2(float(y), float(x))


def _near_hue(lab: Pixels, own: Paint) -> Weights:
    """1 up to the paint's tolerance, falling to 0 beyond; noise widens it in the dark."""
    apart = (_hue(lab) - own.hue + math.pi).remainder(2 * math.pi) - math.pi
    light, dark = NOISE_FADES
    most = DARK_NOISE if own.may_be_natural else 0.0
    noise = most * ((light - lab[0]) / (light - dark)).clamp(0, 1)
    tolerance = own.tolerance + torch.rad2deg(torch.atan2(noise, _chroma(lab)))
    beyond = torch.rad2deg(apart).abs() / tolerance - 1
    return (1 - beyond / HUE_FALL).clamp(0, 1)


def _saturation(lab: Pixels, own: Paint) -> Weights:
    """Chroma over lightness; a highlight adds white, so that the paint's lightness is the most."""
    return _chroma(lab) / lab[0].clamp(DARK, max(DARK, own.lightness))


def _chroma(lab: Pixels) -> Weights:
    return torch.hypot(lab[1], lab[2])


def _hue(lab: Pixels) -> Weights:
    return torch.atan2(lab[2], lab[1])
