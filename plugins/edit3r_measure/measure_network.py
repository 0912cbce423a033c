"""How good a matcher's pose, depth and novel views are on procedural scenes it has not seen.

    python -m edit3r_measure.measure_network --matcher network --size 64 --scenes 48

Two photos go in; a photo between them is predicted at its true pose, in the unit of length that makes the predicted
depths the true ones (median ratio). Compared with copying the nearer photo, copying it blurred, averaging the two,
and with the same reconstructor given true poses and depths.
"""

import argparse
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from edit3r.config import parse_assignments
from edit3r.errors import MatchingError
from edit3r.geometry.cameras import unproject
from edit3r.geometry.rotations import rotation_angle
from edit3r.interfaces import MatchedGeometry, Matcher, Rasterizer, Reconstructor, SceneSample
from edit3r.registry import build
from edit3r.types import Cameras, Gaussians, Views
from edit3r_measure.evaluation.metrics import best_blurred_copy, psnr


@dataclass(frozen=True)
class GeometryScore:
    """One scene; pictures are compared as PSNR [dB]."""

    novel_view: float
    view_1_alone: float  # the same from view 1's Gaussians only
    nearest_copy: float
    blurred_nearest: float  # at the blur that suits it best
    average: float  # of the two photos
    true_geometry: float  # the reconstructor with true poses and depths
    rotation_error: float  # of view 1 [degrees]
    direction_error: float  # of the baseline [degrees]
    point_error: float  # median distance from the true surface point, relative to its depth, after one scale
    confident: float  # mean confidence


class KnownGeometry(Matcher):
    """Stand-in that answers what it was given last."""

    def __init__(self, geometry: MatchedGeometry | None = None) -> None:
        self.geometry = geometry

    def match(self, views: Views) -> MatchedGeometry:
        return self.geometry


class Renderer:
    """Pictures of a reconstructor that is told its geometry."""

    def __init__(self, recon: str, rasterizer: Rasterizer) -> None:
        self._known = KnownGeometry()
        self._reconstructor: Reconstructor = build("reconstructor", recon, parts={"matcher": self._known})
        self._rasterizer = rasterizer

    def gaussians(self, views: Views, geometry: MatchedGeometry) -> Gaussians:
        self._known.geometry = geometry
        return self._reconstructor(views).gaussians

    def picture(self, gaussians: Gaussians, camera: Cameras) -> np.ndarray:
        return _array(self._rasterizer.render(gaussians, camera).images[0, 0].clamp(0, 1))


def measure_scene(sample: SceneSample, matcher: Matcher, renderer: Renderer) -> GeometryScore:
    """Raises MatchingError as the matcher does."""
    views = Views(sample.context[None], sample.context_cameras.intrinsics)
    found, true = matcher.match(views), true_geometry(sample)
    unit = (found.depths / true.depths).median()
    camera = sample.target_cameras.select([0])
    target, photos = _array(sample.target[0]), [_array(photo) for photo in sample.context]
    nearest = photos[_nearest(sample)]
    there, gaussians = _scaled(camera, unit), renderer.gaussians(views, found)
    perfect = renderer.gaussians(views, true)
    return GeometryScore(
        novel_view=psnr(renderer.picture(gaussians, there), target),
        view_1_alone=psnr(renderer.picture(gaussians.from_view(1), there), target),
        nearest_copy=psnr(nearest, target),
        blurred_nearest=best_blurred_copy([nearest], target).psnr,
        average=psnr(np.mean(photos, 0), target),
        true_geometry=psnr(renderer.picture(perfect, camera), target),
        **_pose_errors(found.c2w[0, 1], true.c2w[0, 1]),
        point_error=point_error(found, true, views.intrinsics),
        confident=float(found.confidence.mean()),
    )


def true_geometry(sample: SceneSample) -> MatchedGeometry:
    """What a perfect matcher would say."""
    depths = sample.context_depths[None]
    placed = torch.ones(depths.shape[:2], dtype=torch.bool)
    return MatchedGeometry(sample.context_cameras.c2w, depths, torch.ones_like(depths), placed)


def point_error(found: MatchedGeometry, true: MatchedGeometry, intrinsics: Tensor) -> float:
    """Median over all pixels of both views; the scale is the median ratio of depths."""
    unit = (found.depths / true.depths).median()
    surface = unproject(true.depths, intrinsics, true.c2w)
    predicted = unproject(found.depths, intrinsics, found.c2w) / unit
    return float(((predicted - surface).norm(dim=-1) / true.depths).median())


def _pose_errors(found: Tensor, true: Tensor) -> dict[str, float]:
    cosine = torch.nn.functional.cosine_similarity(found[:3, 3], true[:3, 3], dim=0)
    return {
        "rotation_error": float(torch.rad2deg(rotation_angle(found[:3, :3], true[:3, :3]))),
        "direction_error": float(torch.rad2deg(torch.acos(cosine.clamp(-1, 1)))),
    }


def _scaled(camera: Cameras, unit: Tensor) -> Cameras:
    c2w = camera.c2w.clone()
    c2w[..., :3, 3] *= unit
    return replace(camera, c2w=c2w)


def _nearest(sample: SceneSample) -> int:
    """The context view whose camera stands nearest to the target's."""
    apart = sample.context_cameras.c2w[0, :, :3, 3] - sample.target_cameras.c2w[0, 0, :3, 3]
    return int(apart.norm(dim=-1).argmin())


def _array(image: Tensor) -> np.ndarray:
    return image.permute(1, 2, 0).contiguous().numpy()


@torch.no_grad()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--matcher", default="network")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="matcher settings")
    parser.add_argument("--recon", default="edit3r", help="reconstructor that takes a matcher")
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--scenes", type=int, default=48)
    parser.add_argument("--seed", type=int, default=1000, help="of the scenes; training uses others")
    args = parser.parse_args()
    torch.set_num_threads(1)
    matcher = build("matcher", args.matcher, **parse_assignments(args.set))
    renderer = Renderer(args.recon, build("rasterizer", "numba"))
    data = build("dataset", "procedural", seed=args.seed, image_size=args.size, targets=1, angles=(5, 25))
    scores, failures = [], 0
    for index in range(args.scenes):
        try:
            scores.append(measure_scene(data[index], matcher, renderer))
        except MatchingError:
            failures += 1
    print(f"{args.matcher} {args.set} at {args.size} pixels: {len(scores)} scenes, {failures} not matched")
    for name in GeometryScore.__dataclass_fields__ if scores else ():
        values = np.array([getattr(score, name) for score in scores])
        print(f"  {name:16s} mean {values.mean():7.3f}  median {np.median(values):7.3f}")


if __name__ == "__main__":
    main()
