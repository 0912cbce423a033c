"""Which part of a run is to blame: each is held against the cheapest one that could stand there.

A scene is held against one Gaussian a pixel of the geometry that it was made of, that geometry
against one flat picture, the rasterizer's depths against those of that cheapest scene, and what
refiners made against what they were given. The photos are to blame where nobody else is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from edit3r.contract.interfaces import SceneToJudge
from edit3r.contract.verdicts import Label, Part
from edit3r_judge.signals import SIDE, fitted_limits, unlike_between
from edit3r_judge.skill import LEFT_ALONE, SHOWN, skills, unchanged

WRONG_DEPTHS = 0.1  # by which a sound rasterizer's depths are never off [share]
Figures = Sequence[float | None]


@dataclass(frozen=True)
class Doubt:
    """What speaks against a scene though it may show its photos well."""

    clause: str  # what was found and what to do, instead of advice about the photos
    part: Part  # that is to blame
    best: Label = "fair"  # that the scene can get


@dataclass(frozen=True)
class Beside:
    """How each placed photo's part of a scene compares with the cheapest one; None: not known."""

    geometry: Figures  # how many times as unlike a photo its neighbour is, laid onto it; 1: as good
    # how unlike by the run's geometry (by the scene, where there is none), as a share of one flat
    # picture's; 1: no depth
    flat: Figures
    # how much more of the view half-way looks like no photo, in [-1, 1]
    reference: Figures
    # how far off the rasterizer's depths of the cheapest scene are [share]
    depths: float | None


def beside(scene: SceneToJudge) -> Beside:
    """Nothing is known of a photo that stands alone."""
    unknown: Figures = [None] * scene.edited.count
    geometry, flat = list(unknown), list(unknown)
    for one in skills(scene):
        for worst, figure in ((geometry, one.beside_geometry), (flat, one.beside_flat)):
            if figure is not None:
                worst[one.view] = max(worst[one.view] or 0.0, figure)
    reference, depths = unknown, None
    if scene.reference is not None:
        # neither what refiners nor what the editor did to it is its fault
        before = scene.first_half_way or scene.half_way
        # a run's Gaussians are coarser than its pixels: of a small one half the size is looked at
        side = min(SIDE, max(scene.edited.image_size) // 2)
        same = unchanged(scene, side)
        where = same if float(same.float().mean()) > LEFT_ALONE else None
        own, least = (
            unlike_between(replace(scene, half_way=one), where, side)
            for one in (before, scene.reference.half_way)
        )
        reference = [
            None if mine is None or theirs is None else mine - theirs
            for mine, theirs in zip(own, least)
        ]
        shown = scene.reference.first
        seen = (shown.alphas > SHOWN)[0, 0, 0]
        if seen.any():
            off = shown.depths[0, 0, 0] / scene.reference.depths - 1
            depths = float(off[seen].abs().median())
    return Beside(geometry, flat, reference, depths)


def broken_part(scene: SceneToJudge, figures: Beside, worse: float) -> Doubt | None:
    """The part without which the scene would be sound; None: all are, as far as one can tell.

    `worse` is what refiners took of a photo's agreement [dB].
    """
    limits, names = fitted_limits("scene")["beside"], scene.components
    flat, lost, between = map(
        _worst, (figures.flat, figures.geometry, figures.reference)
    )
    no_depth = flat is not None and flat > limits["flat"]
    if figures.depths is not None and figures.depths > WRONG_DEPTHS:
        return Doubt(
            f"the rasterizer{_called(names, 'rasterizer')} draws depths that are off by "
            f"{figures.depths:.0%}: take another (--rasterizer)",
            "rasterizer",
            "poor",
        )
    if no_depth and scene.geometry is not None:
        return Doubt(
            "the depths and places that"
            f"{_called(names, 'geometry') or ' the geometry'} found explain the photos no better "
            "than one flat picture does, though the photos agree with each other: take another "
            "(--matcher)",
            "geometry",
            "poor",
        )
    if worse > limits["refined"]:
        return Doubt(
            f"the refiners{_called(names, 'refiner')} made it worse, by {worse:.0f} dB: leave them "
            "out (--refine 0 --gaussians all)",
            "refiner",
            "poor",
        )
    recon = f"the reconstructor{_called(names, 'reconstructor')}"
    if no_depth:
        return Doubt(
            f"the scene is no better than one flat picture: {recon} found no depth",
            "reconstructor",
            "poor",
        )
    if lost is not None and lost > limits["geometry"]:
        return Doubt(
            f"{recon} lost the depth that the run had: laid onto each other by it, photos differ "
            f"{lost:.1f} times as much",
            "reconstructor",
            "poor",
        )
    if between is not None and between > limits["reference"]:
        return Doubt(
            f"{recon} makes less of the run's depths than a dot for each pixel: half-way between "
            f"photos {between:.0%} more of the picture looks like no photo",
            "reconstructor",
            "poor",
        )
    return None


def _worst(figures: Figures) -> float | None:
    return max((one for one in figures if one is not None), default=None)


def _called(names: Mapping[str, str], kind: str) -> str:
    return f" {names[kind]}" if names.get(kind) else ""
