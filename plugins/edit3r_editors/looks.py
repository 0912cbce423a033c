"""The editor `looks`: a named look for the picture or for what is masked, by colour grading and
classical filters.

Nothing here is generative: autumn turns green into orange, but no leaf falls; marble gets veins
along the photo's own shades. A look changes each pixel by its own colour, or by a small
neighbourhood, so that a surface looks alike in all views; no pattern depends on places in the
picture, where it would swim over the surfaces. Two looks are no decoration: they hide what is there
for good (`hiding`).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

import cv2
import kornia
import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

import edit3r
from edit3r.contract.errors import PromptError, did_you_mean
from edit3r.contract.instructions import Instruction, Target
from edit3r.contract.interfaces import Editor, EditsRegions, HidesThings
from edit3r.contract.reporting import say
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.compute.layers import one_thread
from edit3r.kit.files.configs import read_yaml
from edit3r_editors.hiding import blurred, pixelated

Images = Float[Tensor, "view 3 height width"]
Grey = Float[Tensor, "view 1 height width"]
grey = kornia.color.rgb_to_grayscale

Numbers = Sequence[float]


def graded(
    images: Images,
    gamma=1.0,
    saturation=1.0,
    contrast=1.0,
    gain=(1.0, 1.0, 1.0),
    lift=0.0,
) -> Images:
    """Grade each pixel: gamma, saturation, contrast around mid-grey, gain of RGB, lifted blacks."""
    images = images.clamp(min=1e-4) ** gamma
    light = grey(images)
    images = 0.5 + contrast * (light + saturation * (images - light) - 0.5)
    return (lift + (1 - lift) * images * _colour(images, *gain)).clamp(0, 1)


def autumn(
    images: Images,
    green: Numbers,
    turned: Numbers,
    saturation: Numbers,
    value: Numbers,
    grade: Mapping,
) -> Images:
    """Turn hues of plants [degrees] from `green` to `turned`; factors and limits of the rest."""
    hsv, weight = _foliage(images)
    share = (torch.rad2deg(hsv[:, :1]) - green[0]) / (green[1] - green[0])
    hue = turned[0] + (turned[1] - turned[0]) * share.clamp(0, 1)
    channels = [
        (factor * hsv[:, [channel]]).clamp(max=most)
        for channel, (factor, most) in ((1, saturation), (2, value))
    ]
    leaves = kornia.color.hsv_to_rgb(torch.cat((torch.deg2rad(hue), *channels), 1))
    return graded(torch.lerp(images, leaves, weight), **grade)


def winter(
    images: Images, gamma: float, tint: Numbers, share: float, grade: Mapping
) -> Images:
    frost = grey(images).clamp(min=1e-4) ** gamma * _colour(images, *tint)
    frosted = torch.lerp(images, frost.clamp(0, 1), share * _foliage(images)[1])
    return graded(frosted, **grade)


def sketch(
    images: Images, smooth: Numbers, line: float, tone: Numbers, paper: Numbers
) -> Images:
    light = grey(_flattened(images, *smooth))
    dark, range_, bright = tone
    shade = dark + range_ * _step(light, 0, bright)
    return _lines(light, line) ** 2 * shade * _colour(images, *paper)


def cartoon(
    images: Images,
    smooth: Numbers,
    line: float,
    ink: Numbers,
    flat: Numbers,
    grade: Mapping,
) -> Images:
    lines = _step(_lines(grey(_flattened(images, *smooth)), line), *ink)
    return lines * graded(_flattened(images, *flat), **grade)


def watercolour(
    images: Images, smooth: Numbers, line: float, colour: float, grade: Mapping
) -> Images:
    """Flatten into washes with darker rims, on paper that shines through."""
    washes = _flattened(images, *smooth)
    washes = washes * _lines(grey(washes), line)
    return 1 - colour * (1 - graded(washes, **grade))


def marble(
    images: Images,
    lines: Numbers,
    widths: Numbers,
    depths: Numbers,
    clear: Numbers,
    vein: Numbers,
    tone: Numbers,
    stone: Numbers,
) -> Images:
    """White stone in the photo's shades; veins along lines of equal light, thin in a shadow."""
    phase, slope = _shades(images, *lines)
    # to the line [pixels]
    distance = (phase - phase.round()).abs() / slope.clamp(min=0.005)
    thin, wide = (
        depth * torch.exp(-((distance / width) ** 2))
        for width, depth in zip(widths, depths)
    )
    veins = thin.maximum(wide) * _step(slope, *clear) * _colour(images, *vein)
    return _toned(images, tone) * _colour(images, *stone) * (1 - veins)


def _toned(images: Images, tone: Numbers) -> Grey:
    """Smooth light from the first number by the second, at most where light is the third."""
    dark, range_, bright = tone
    return dark + range_ * _step(grey(_flattened(images, 10, 0.1)), 0, bright)


def _shades(images: Images, lines: float, sigma: float) -> tuple[Grey, Grey]:
    """Smooth light from 0 to `lines`, and its slope [1 / pixels]."""
    smooth = _by_opencv(images, partial(cv2.medianBlur, ksize=15))
    phase = lines * _blurred(grey(_flattened(smooth, 60, 0.5)), sigma)
    slope = kornia.filters.spatial_gradient(phase)[:, 0].norm(dim=1, keepdim=True)
    return phase, slope


def _colour(images: Images, *rgb: float) -> Float[Tensor, "3 1 1"]:
    return images.new_tensor(rgb)[:, None, None]


def wood(
    images: Images,
    lines: Numbers,
    clear: Numbers,
    lost: Numbers,
    depth: float,
    tone: Numbers,
    colours: Sequence[Numbers],
) -> Images:
    """Brown in the photo's shades; soft rings run along lines of equal light, as marble's veins."""
    phase, slope = _shades(images, *lines)
    seen = _step(slope, *clear) * (1 - _step(slope, *lost))
    rings = depth * (1 + torch.cos(2 * math.pi * phase)) * seen
    return _toned(images, tone) * _between(images, rings, colours)


def snow(images: Images, tone: Numbers, colours: Sequence[Numbers]) -> Images:
    """White in light and pale blue in shade."""
    return _between(images, _toned(images, tone), colours)


def _between(
    images: Images,
    share: Float[Tensor, "view 1 height width"],
    colours: Sequence[Numbers],
) -> Images:
    """From the first colour (sRGB) to the second, by a share of each pixel."""
    first, second = (_colour(images, *one) for one in colours)
    return first + share * (second - first)


def metal(
    images: Images,
    smooth: Numbers,
    range_: Numbers,
    banded: float,
    bands: Sequence[Numbers],
    places: Numbers,
    colours: Sequence[Numbers],
) -> Images:
    """The banded light of polished metal, in colours (sRGB) of shades, middle and highlights.

    `bands` say what light becomes which light; the dips are what makes it look like reflections.
    """
    median = _by_opencv(images, partial(cv2.medianBlur, ksize=5))
    flat = _step(grey(_flattened(median, *smooth)), *range_)
    shade, light = (one[:, 0].numpy(force=True) for one in (flat, grey(median)))
    reflected = np.interp(shade, bands[0], bands[1])
    shine = banded * reflected + (1 - banded) * light
    channels = [np.interp(shine, places, (0, *stops)) for stops in zip(*colours)]
    return torch.from_numpy(np.stack(channels, 1)).to(images)


def _foliage(images: Images) -> tuple[Images, Grey]:
    """HSV of each pixel, and how much it is as green as plants, in [0, 1]."""
    hsv = kornia.color.rgb_to_hsv(images)
    hue = torch.rad2deg(hsv[:, :1])
    green = _step(hue, 40, 65) * (1 - _step(hue, 165, 195))
    return hsv, green * _step(hsv[:, 1:2], 0.06, 0.2)


def _step(values: Grey, low: float, high: float) -> Grey:
    """0 below `low`, 1 above `high`, smooth between."""
    share = ((values - low) / (high - low)).clamp(0, 1)
    return share * share * (3 - 2 * share)


def _lines(light: Grey, sigma: float) -> Grey:
    """Light over the light around (colour dodge): 1 but for dark lines."""
    return (light / _blurred(light, sigma).clamp(min=0.02)).clamp(0, 1)


def _blurred(images: Grey, sigma: float) -> Grey:
    """Blur by `sigma` [longer sides]."""
    sigma = sigma * max(images.shape[-2:])
    size = 2 * int(3 * sigma) + 1
    return kornia.filters.gaussian_blur2d(
        images, (size, size), (sigma, sigma), border_type="replicate"
    )


def _flattened(images: Images, reach: float, range_: float) -> Images:
    """Smooth within edges (Gastal and Oliveira 2011); `reach` [pixels], `range_` of colours."""
    draw = partial(cv2.edgePreservingFilter, flags=1, sigma_s=reach, sigma_r=range_)
    return _by_opencv(images, draw)


def _by_opencv(images: Images, draw: Callable[[np.ndarray], np.ndarray]) -> Images:
    """Apply a filter of OpenCV, which takes bytes in BGR."""
    bgr = (images.permute(0, 2, 3, 1).flip(-1) * 255).round().to(torch.uint8)
    pixels = bgr.numpy(force=True)
    drawn = np.stack([draw(np.ascontiguousarray(image)) for image in pixels])
    return torch.from_numpy(drawn).flip(-1).permute(0, 3, 1, 2).to(images) / 255


class Look(NamedTuple):
    """What a prompt calls a look, what it does, and how."""

    words: tuple[str, ...]
    does: str
    # of one that hides, `draw(images, where)`: what it draws depends on all of the region
    draw: Callable[..., Images]
    hides: bool = False


def _looks() -> dict[str, Look]:
    """The looks of `looks.yaml`: words, what it does, and a filter of this file with numbers."""
    drawn = autumn, winter, sketch, cartoon, watercolour, marble, wood, snow, metal
    hiding = blurred, pixelated
    filters = {one.__name__: one for one in (graded, *drawn, *hiding)}
    looks = {}
    for name, look in read_yaml(Path(__file__).with_name("looks.yaml")).items():
        draw = filters[look.pop("draw", "graded")]
        filled = partial(draw, **look.pop("with", {}))
        words = tuple(look["words"].split())
        looks[name] = Look(words, look["does"], filled, draw in hiding)
    return looks


LOOKS = _looks()
"""Every look by its name."""

_NAMES = ("", *LOOKS)
BY_WORD = {word: name for name, look in LOOKS.items() for word in look.words}


class LooksEditor(Editor, EditsRegions, HidesThings):
    """Gives photos, or things in them, one named look.

    Colour grading and classical filters, not a generative editor.
    """

    class Settings(edit3r.Settings):
        look: Literal[_NAMES] = Field(  # type: ignore[valid-type]  # of LOOKS
            "", description="the look; empty: the one that the prompt names"
        )
        strength: float = Field(1.0, ge=0, le=1)
        """share of the look; 0 returns the photo; blur and pixelate hide wholly or not at all"""

    settings: Settings

    def understands(self, instruction: Instruction) -> bool:
        return bool(self.settings.look) or look_of(instruction) != ""

    def hides(self, instruction: Instruction) -> bool:
        name = self.settings.look or look_of(instruction)
        if not name or not LOOKS[name].hides:
            return False
        if self.settings.strength < 1:
            raise PromptError(
                f"{instruction.text!r} hides wholly or not at all, and editor.strength is "
                f"{self.settings.strength:g}; leave it out."
            )
        return True

    def instruction_of_nothing(self) -> Instruction | None:
        if not self.settings.look:
            return None
        return Instruction(
            "look", Target("whole"), look=self.settings.look, text=self.settings.look
        )

    @one_thread()  # powers differ in their last bits by where threads divide an image
    def edit(self, views: Views, request: EditRequest) -> Views:
        given = self.instruction_of_nothing()
        instructions = request.asked() if given is None else (given,)
        photos = views.images.flatten(0, 1)
        for number, instruction in enumerate(instructions):
            name = self.settings.look or look_of(instruction)
            if not name:
                listed = ", ".join(LOOKS)
                hint = (
                    did_you_mean(instruction.look, BY_WORD) if instruction.look else ""
                )
                raise PromptError(
                    f"{instruction.text!r} names no look that the editor looks knows.{hint} Looks "
                    f"are {listed}."
                )
            say("look", f"{name}: {LOOKS[name].does}")
            region = torch.ones_like(photos[:, 0])
            if request.regions is not None:
                region = request.regions[number].flatten(0, 1).to(photos)
            if LOOKS[name].hides:
                photos = LOOKS[name].draw(photos, region > 0)
                continue
            drawn = LOOKS[name].draw(photos).expand_as(photos).clamp(0, 1)
            weight = self.settings.strength * region[:, None]
            photos = torch.lerp(photos, drawn, weight)
        return replace(views, images=photos.view_as(views.images))


def look_of(instruction: Instruction) -> str:
    """The name of the one look that an instruction asks for; "" where it names none, or several."""
    spoken = instruction.look.split()
    if instruction.action == "paint" and len(instruction.changes) == 1:
        spoken = [instruction.changes[0].material, instruction.changes[0].kind]
    named = dict.fromkeys(BY_WORD[word] for word in spoken if word in BY_WORD)
    return next(iter(named)) if len(named) == 1 else ""
