"""How far the pictures of each point are from those of the most accurate one."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import numpy as np
from PIL import Image

from edit3r_measure.evaluation.metrics import psnr
from edit3r_measure.tradeoff.figures import Figures, MeasuredPoint, Measurement

Pictures = dict[tuple[str, str], np.ndarray]  # (label, scene) to novel view [height, width, 3] in [0, 1]


def with_distances(
    points: Sequence[MeasuredPoint], measurements: Sequence[Measurement], picture: Callable[[str], Path]
) -> list[MeasuredPoint]:
    """Fill in `Figures.distance`; `picture` is a measurement's key to the file of its novel view.

    The most accurate point of a kind of scene has none, nor has a point whose files are gone.
    """
    for kind in points[0].kinds if points else ():
        group = [m for m in measurements if m["kind"] == kind and picture(m["key"]).is_file()]
        pictures = {(m["label"], m["scene"]): _read(picture(m["key"])) for m in group}
        best = max(points, key=lambda point: point.kinds[kind].psnr)
        points = [_with_distance(point, best, kind, pictures) for point in points]
    return list(points)


def _with_distance(point: MeasuredPoint, best: MeasuredPoint, kind: str, pictures: Pictures) -> MeasuredPoint:
    scenes = [scene for label, scene in pictures if label == point.label and (best.label, scene) in pictures]
    if point.label == best.label or not scenes:
        return point
    distance = fmean(psnr(pictures[point.label, scene], pictures[best.label, scene]) for scene in scenes)
    figures: Figures = replace(point.kinds[kind], distance=distance)
    return replace(point, kinds={**point.kinds, kind: figures})


def _read(file: Path) -> np.ndarray:
    return np.asarray(Image.open(file), np.float32) / 255
