"""From a sweep to the file that ships: which points, and which of them are the presets."""

from collections.abc import Mapping, Sequence
from typing import Any

from edit3r.quality import Expected, Quality, ShippedPoint
from edit3r_measure.tradeoff.figures import Figures, MeasuredPoint, Spread
from edit3r_measure.tradeoff.front import choose_presets, on_every_front
from edit3r_measure.tradeoff.knobs import SweepPlan

APART = 2.1
"""How many times as quick each preset is as the next: the twice that is promised, and something for noise."""


def make_quality(points: Sequence[MeasuredPoint], measured: Mapping[str, Any], plan: SweepPlan) -> Quality:
    """All points, quickest first by `measured["clock"]`; those on every front and the presets are marked.

    Only what `plan.shipped` names is a preset's business; a point that differs from the base elsewhere (in the number
    of photos, say) is measured but not shipped.
    """
    clock = measured["clock"]
    able = [point for point in points if _rest(point.settings, plan) == _rest(plan.base, plan)]
    rated = [point.rated(clock) for point in able]
    chosen = {point.name: preset for preset, point in choose_presets(rated, APART).items()}
    shipped = [
        ShippedPoint(
            label=point.label,
            front=flag,
            preset=chosen.get(point.label),
            settings={key: value for key, value in point.settings.items() if key in plan.shipped},
            expected={kind: _expected(figures, clock) for kind, figures in point.kinds.items()},
        )
        for point, flag in zip(able, on_every_front(rated))
    ]
    return Quality(measured=dict(measured), points=sorted(shipped, key=lambda point: point.seconds))


def _rest(settings: Mapping[str, Any], plan: SweepPlan) -> dict[str, Any]:
    return {key: value for key, value in settings.items() if key not in plan.shipped}


def _expected(figures: Figures, clock: str) -> Expected:
    seconds: Spread = getattr(figures, clock)
    return Expected(
        seconds=round(seconds.least, 3),
        seconds_first=round(figures.first[clock], 3),
        seconds_middle=round(seconds.middle, 3),
        seconds_most=round(seconds.most, 3),
        memory_mb=round(figures.memory_mb),
        start_memory_mb=round(figures.start_memory_mb),
        gaussians=round(figures.most_gaussians),
        psnr=round(figures.psnr, 2),
        ssim=round(figures.ssim, 4),
    )
