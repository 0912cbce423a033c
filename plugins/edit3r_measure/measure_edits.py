"""How well a reconstructor carries and fuses edits, on procedural scenes it has not seen: numbers and pictures.

    python -m edit3r_measure.measure_edits --recon edit3r --size 128 --scenes 24
    python -m edit3r_measure.measure_edits --size 64 --weights runs/a/best/weights.safetensors runs/b/best/...

The reconstructor runs as it does for a user, matching included. An object that both photos show is recoloured: in the
reference alone (uptake, error, leak of view 1's Gaussians seen from view 1) or in both views differently
(disagreement of what the two views' Gaussians show from between, relative to the inputs').
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from edit3r_recolor.api import (
    RecolorParameters,
    draw_outline,
    perturbed,
    recolored,
    visible_parameters,
    with_outline,
)
from torch import Tensor

from edit3r.config import parse_assignments
from edit3r.errors import MatchingError
from edit3r.interfaces import MatchedGeometry, Matcher, Rasterizer, Reconstructor, SceneSample
from edit3r.registry import build
from edit3r.types import Cameras, Gaussians, Reconstruction, Views


@dataclass(frozen=True)
class EditScore:
    """One scene; changes are against the same reconstruction of the unedited photos."""

    uptake: float  # projection of view 1's change on the true one, inside the object; 1 is all of it
    error: float  # |change - true change| over |true change|, inside
    leak: float  # mean |change| outside the object [sRGB]
    disagreement: float  # |change of view 0's Gaussians - of view 1's| over that of two different edits
    kept: float  # projection of all Gaussians' change on the reference's edit, when both views were edited
    edited_psnr: float  # novel view of the edited scene against its truth [dB], reference edited alone
    unedited_psnr: float  # the same without an edit [dB]


@dataclass(frozen=True)
class _Case:
    """A scene with an object to edit."""

    sample: SceneSample
    mask: Tensor  # [view + target, height, width]
    first: Tensor  # all pictures under the reference's edit
    second: Tensor  # and under another one
    given: Tensor  # [2, 3, height, width]: the two photos' edits as the reconstructor is given them

    @property
    def pictures(self) -> Tensor:
        return torch.cat((self.sample.context, self.sample.target))


def measure_scene(
    sample: SceneSample, reconstructor: Reconstructor, rasterizer: Rasterizer, seed: int, faults: bool = False
) -> EditScore | None:
    """None when no object is seen well enough by the photos. Raises MatchingError as the reconstructor does.

    With `faults` the edits are given as an editor makes them; what is right stays the same.
    """
    case = _case(sample, seed, faults)
    if case is None:
        return None
    source = _views(sample, sample.context)
    alone = _views(sample, torch.stack((case.given[0], sample.context[1])))
    both = _views(sample, case.given)
    plain, carried, fused = (reconstructor(views, source) for views in (source, alone, both))
    own = plain.cameras.select([1])
    between = _target_camera(sample, plain)

    def change(edited: Reconstruction, view: int | None, camera: Cameras) -> tuple[Tensor, Tensor]:
        before, after = (_shown(r.gaussians, view, rasterizer, camera) for r in (plain, edited))
        return after[0] - before[0], before[1] > 0.5

    shown, covered = change(carried, 1, own)
    true = case.first[1] - sample.context[1]
    inside, outside = (case.mask[1] > 0.5) & covered, (case.mask[1] == 0) & covered
    target_true = case.first[2] - sample.target[0]
    (a, seen_a), (b, seen_b), (all_, seen) = (change(fused, view, between) for view in (0, 1, None))
    region = (case.mask[2] > 0.5) & seen_a & seen_b
    apart = (case.first[2] - case.second[2]).abs()[:, region].mean()
    pictures = [_shown(r.gaussians, None, rasterizer, between)[0] for r in (plain, carried)]
    return EditScore(
        uptake=_projection(shown, true, inside),
        error=float((shown - true).abs()[:, inside].sum() / true.abs()[:, inside].sum()),
        leak=float(shown.abs()[:, outside].mean()),
        disagreement=float((a - b).abs()[:, region].mean() / apart),
        kept=_projection(all_, target_true, (case.mask[2] > 0.5) & seen),
        edited_psnr=_psnr(pictures[1], case.first[2]),
        unedited_psnr=_psnr(pictures[0], sample.target[0]),
    )


def _case(sample: SceneSample, seed: int, faults: bool) -> _Case | None:
    masks = torch.cat((sample.context_masks, sample.target_masks), 1)
    area = masks.mean((2, 3)).amin(1)
    fit = np.flatnonzero((area > 0.02).numpy() & (area < 0.4).numpy())
    if len(fit) == 0:
        return None
    rng = np.random.default_rng(seed)
    mask = masks[rng.choice(fit)]
    pictures = torch.cat((sample.context, sample.target))
    looks = [visible_parameters(rng, pictures, mask) for _ in range(2)]
    first, second = (recolored(pictures, mask[None], [look]) for look in looks)
    given = torch.stack((first[0], second[1]))
    if faults:
        given = torch.stack([_faulty(pictures[view], mask[view], looks[view], rng) for view in (0, 1)])
    return _Case(sample, mask, first, second, given)


def _faulty(photo: Tensor, mask: Tensor, look: RecolorParameters, rng: np.random.Generator) -> Tensor:
    """The edit with a wrong outline and colours a little off."""
    spoilt = with_outline(mask, draw_outline(rng))
    return recolored(photo[None], spoilt[None, None], [perturbed(look, rng)])[0]


def _views(sample: SceneSample, images: Tensor) -> Views:
    return Views(images[None], sample.context_cameras.intrinsics)


def _target_camera(sample: SceneSample, reconstruction: Reconstruction) -> Cameras:
    """The first target's true pose in the predicted unit of length (ratio of the baselines)."""
    predicted = reconstruction.cameras.c2w[0, 1, :3, 3].norm()
    unit = predicted / sample.context_cameras.c2w[0, 1, :3, 3].norm()
    camera = sample.target_cameras.select([0])
    c2w = camera.c2w.clone()
    c2w[..., :3, 3] *= unit
    return replace(camera, c2w=c2w)


def _shown(gaussians: Gaussians, view: int | None, rasterizer: Rasterizer, camera: Cameras) -> tuple[Tensor, Tensor]:
    """Picture and alpha of all Gaussians, or of one view's."""
    chosen = gaussians if view is None else gaussians.from_view(view)
    rendering = rasterizer.render(chosen, camera)
    return rendering.images[0, 0].clamp(0, 1), rendering.alphas[0, 0, 0]


def _projection(shown: Tensor, true: Tensor, region: Tensor) -> float:
    return float((shown * true)[:, region].sum() / true[:, region].square().sum())


def _psnr(a: Tensor, b: Tensor) -> float:
    return float(-10 * torch.log10((a - b).square().mean()))


class _RememberingMatcher(Matcher):
    """Matches each scene's photos once, however often they are asked for in a row."""

    def __init__(self, matcher: Matcher) -> None:
        self.matcher = matcher
        self._photos: Tensor | None = None
        self._answer: MatchedGeometry | MatchingError | None = None

    def match(self, views: Views) -> MatchedGeometry:
        if self._photos is None or not torch.equal(self._photos, views.images):
            self._photos = views.images
            try:
                self._answer = self.matcher.match(views)
            except MatchingError as error:
                self._answer = error
        if isinstance(self._answer, MatchingError):
            raise self._answer
        return self._answer


def _reconstructors(name: str, settings: dict, weights: Sequence[str]) -> dict[str, Reconstructor]:
    """One for each file of weights, by that file's name; they share their matcher's answers."""
    choices = {_short(file): {**settings, "weights": file} for file in weights} or {name: settings}
    built = {label: build("reconstructor", name, **given) for label, given in choices.items()}
    first = next(iter(built.values()))
    if isinstance(getattr(first, "matcher", None), Matcher):
        shared = _RememberingMatcher(first.matcher)
        for reconstructor in built.values():
            reconstructor.matcher = shared
    return built


def _short(file: str) -> str:
    """The run's name where the file is its best weights, else the file's."""
    parts = Path(file).parts
    return parts[-3] if parts[-2:-1] == ("best",) and len(parts) > 2 else Path(file).stem


@torch.no_grad()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recon", default="edit3r")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="reconstructor settings")
    parser.add_argument("--weights", nargs="+", default=[], metavar="FILE", help="compare these on the same scenes")
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--scenes", type=int, default=24)
    parser.add_argument("--seed", type=int, default=1000, help="of the scenes; training uses 1 to 4")
    parser.add_argument("--faults", action="store_true", help="edits with wrong outlines and palettes a little off")
    args = parser.parse_args()

    torch.set_num_threads(1)
    reconstructors = _reconstructors(args.recon, parse_assignments(args.set), args.weights)
    rasterizer = build("rasterizer", "numba")
    data = build("dataset", "procedural", seed=args.seed, image_size=args.size, targets=1, angles=(5, 25))
    scores: dict[str, list[EditScore]] = {label: [] for label in reconstructors}
    failures = 0
    for index in range(args.scenes):
        try:
            row = {
                label: measure_scene(data[index], r, rasterizer, index, args.faults)
                for label, r in reconstructors.items()
            }
        except MatchingError:
            failures += 1
            continue
        for label, score in row.items():
            scores[label] += [] if score is None else [score]
    for label, measured in scores.items():
        print(f"{label} {args.set} at {args.size} pixels: {len(measured)} scenes, {failures} not matched")
        _print_means(measured)


def _print_means(scores: Sequence[EditScore]) -> None:
    for name in EditScore.__dataclass_fields__:
        values = np.array([getattr(score, name) for score in scores])
        values = values[np.isfinite(values)]
        print(f"  {name:14s} mean {values.mean():7.3f}  median {np.median(values):7.3f}")


if __name__ == "__main__":
    main()
