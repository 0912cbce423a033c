"""One number for an edit, made so that no single virtue wins: an edit that arrives, agrees with itself and stays put.

C-FID and C-KID reward doing nothing, consistency does too, and strength rewards destroying the scene. So what arrived
of the edit is multiplied by how well it agrees and stays put: doing nothing scores 0, whatever else is measured.
"""

import math

from edit3r_measure.bench.results import ItemResult

__all__ = ["FULL_STRENGTH", "SPOILED", "score"]

FULL_STRENGTH = 0.04
"""Change of the 2D edit from which it counts as one, where no truth says how strong it should be [sRGB, low-passed]."""

SPOILED = 0.1
"""Disagreement between views, or change outside the masks, at which nothing is left of that share [sRGB]."""


def score(result: ItemResult) -> float:
    """In [0, 1]: arrived x (agrees x stays put)^(1/2); 0 for a failure.

    Arrived is the uptake of the true change at held-back views; without truth, the uptake of the 2D edit at its own
    view times min(1, its strength / FULL_STRENGTH). Agrees is 1 - (mean of both consistencies) / SPOILED, stays put
    is 1 - change outside / SPOILED (1 for global edits), all held in [0, 1]. What is not in it: whether the edit is
    the one that was asked for where there is no truth (CLIP), and how sharp it is (PSNR, SSIM, C-KID).
    """
    if result.failure:
        return 0.0
    return arrived(result) * math.sqrt(agrees(result) * stays_put(result))


def arrived(result: ItemResult) -> float:
    """Share of the wished change that is shown."""
    metrics = result.metrics
    if "edit-uptake" in metrics:
        return _share(metrics["edit-uptake"])
    return _share(metrics["edit-uptake-2d"]) * min(1.0, metrics["edit-strength-2d"] / FULL_STRENGTH)


def agrees(result: ItemResult) -> float:
    """1 when the views agree wherever two see the same point; 0 where no point is seen twice."""
    names = ("consistency-warped", "consistency-held-back")
    known = [value for name in names if math.isfinite(value := result.metrics[name])]
    return _share(1 - sum(known) / len(known) / SPOILED) if known else 0.0


def stays_put(result: ItemResult) -> float:
    """1 when nothing changed outside the masks, or when there is no outside."""
    outside = result.metrics["change-outside"]
    return 1.0 if math.isnan(outside) else _share(1 - outside / SPOILED)


def _share(value: float) -> float:
    return min(1.0, max(0.0, value))
