"""Does a scene's uncertainty tell where it is wrong? Views that no run was given, beside plain
guesses.

    python benchmarks/uncertainty.py DATA --keep /tmp/runs
    python benchmarks/uncertainty.py DATA --keep /tmp/runs --fit
    python benchmarks/uncertainty.py DATA --keep /tmp/runs --fresh

DATA is a folder of photo sets with known cameras. The default run makes a scene of each set from
its photos alone, without an edit. Its uncertainty is rendered in the photos between and beside
them, at their true cameras relative to the nearest photo. The formula is fitted to the other scenes
each time (leave one scene out), never to those of `held_out.py`. For each set: rank correlation
(Spearman) with the true error of a pixel, and the area under the sparsification curve (mean error
of the surest pixels that are kept), 0: as good as the true error, 1: as good as chance. Then ten
bins of pixels: the promise and what came true. `--fit` prints the constants of all scenes, for
`edit3r_uncertainty/signals.py`; `--fresh` judges those constants on a scene that took no part in
any choice; `--without` leaves a signal out. `--keep` keeps the runs.
"""

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from edit3r_uncertainty.run import read_run
from edit3r_uncertainty.signals import (
    CONSTANT,
    SIGNALS,
    WRONG,
    photos_of,
    probability,
    signals_of,
)
from harness import HELD_OUT
from scipy.stats import spearmanr
from torch import Tensor
from verdict import between

import edit3r
from edit3r import Cameras, Gaussians, build
from edit3r.contract.errors import Edit3rError
from edit3r.kit.geometry.cameras import unproject
from edit3r.kit.photos.posed_folder import read_posed_folder
from edit3r.kit.rendering import render_numbers, render_uncertainty

SETS = {
    "bear": ((0, 2), (10, 14), (20, 22), (30, 32, 34), (40, 42)),
    "fox": ((0, 4), (10, 14), (20, 22, 24), (25, 29, 33, 37), (2, 6), (40, 44)),
    "fern": ((0, 2), (5, 9), (10, 12, 14), (2, 6, 10, 14), (15, 18)),
    "dinosaur": ((14, 17),),
    "monstree": ((0, 2), (4, 6), (8, 10, 12), (14, 16), (0, 3)),
    "berlin": ((0, 2), (0, 1)),
}
"""Photos of each set; others of these scenes were refused by the run."""
FRESH = {"7scenes_rgbd": ((0, 1), (4, 6), (8, 10), (12, 14, 16), (18, 20))}
STEP = 7  # every so many pixels are compared
BINS = 10


@dataclass(frozen=True)
class Judged:
    """One set's scene with its signals, and the pixels of the photos that it was not given."""

    scene: str
    gaussians: Gaussians
    signals: Tensor  # [gaussian, signal]
    shown: Tensor  # [view, gaussian]
    cameras: Cameras  # of the photos not given
    error: Tensor  # [camera, pixel], mean of red, green and blue
    alpha: Tensor  # [camera, pixel]
    plain: dict[str, Tensor]  # plain guesses [camera, pixel], higher: less sure

    @cached_property
    def pixels(self) -> Tensor:
        """The signals where the scene shows something, rendered `[camera * pixel, signal]`."""
        lowest = self.signals.amin(0)
        alpha = self.alpha.clamp(min=0.05)
        columns = [
            self.rendered(column - low) / alpha + low
            for column, low in zip(self.signals.T, lowest)
        ]
        return torch.stack(columns, -1).flatten(0, 1)

    def rendered(self, numbers: Tensor) -> Tensor:
        """Numbers >= 0 `[gaussian]` in the pixels `[camera, pixel]`."""
        maps = render_numbers(
            RASTERIZER, self.gaussians, numbers[None], self.cameras
        ).images
        return sampled(maps[0, :, 0])


RASTERIZER = build("rasterizer", "auto")


def sampled(maps: Tensor) -> Tensor:
    return maps.flatten(1)[:, ::STEP]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of photo sets")
    parser.add_argument("--keep", type=Path, help="folder that keeps the runs")
    parser.add_argument("--fit", action="store_true", help="print the constants")
    parser.add_argument("--fresh", action="store_true", help="judge the constants")
    parser.add_argument("--without", choices=SIGNALS, help="leave a signal out")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, torch.no_grad():
        keep = args.keep or Path(folder)
        keep.mkdir(exist_ok=True)
        sets = [
            one
            for scene, photos in (FRESH if args.fresh else SETS).items()
            for chosen in photos
            if (one := judged(args.data / scene, chosen, keep)) is not None
        ]
    if args.without:
        for one in sets:
            one.signals[:, list(SIGNALS).index(args.without)] = 0
    if args.fit:
        factors, constant = fitted(for_fitting(sets))
        for name, factor in zip(SIGNALS, factors.tolist()):
            print(f'"{name}": {factor:.3f},')
        print(f"CONSTANT = {constant:.3f}")
        return
    given = torch.tensor(list(SIGNALS.values())), CONSTANT
    report(sets, given if args.fresh else None)


def judged(folder: Path, chosen: Sequence[int], keep: Path) -> Judged | None:
    """A set's scene, reconstructed where `keep` does not hold it; None: refused."""
    posed = read_posed_folder(folder).cameras
    centres = np.stack([camera.c2w[:3, 3] for camera in posed])
    targets = list(
        dict.fromkeys(k for k in between(centres, list(chosen)) if k is not None)
    )
    free = [k for k in range(len(posed)) if k not in (*chosen, *targets)]
    if free:  # the nearest other photo, which may lie outside
        steps = np.linalg.norm(centres[free, None] - centres[list(chosen)], axis=-1)
        targets.append(free[int(steps.min(1).argmin())])
    files = [folder / posed[k].file for k in (*chosen, *targets)]
    views = edit3r.load_views(files)
    given = replace(views.select(range(len(chosen))), c2w=None)
    place = keep / "_".join(map(str, (folder.name, *chosen)))
    if not place.is_dir():
        try:
            result = edit3r.run(given, editor="none", outputs=("scene", "images"))
        except Edit3rError as error:
            print(f"{place.name}: refused, {error}")
            return None
        result.save(place)
    run = read_run(place)
    placed = [views.names.index(name) for name in run.names]
    cameras, shown = held_out(run.cameras, views, placed, len(chosen))
    images = views.images[0, len(chosen) :][shown]
    signals, contributions = signals_of(
        run.gaussians, run.cameras, run.edited, RASTERIZER
    )
    rendering = RASTERIZER.render(run.gaussians, cameras)
    wrong = rendering.images[0].clamp(0, 1) - images
    alphas = rendering.alphas[0, :, 0]
    points = unproject(rendering.depths[:, :, 0], cameras.intrinsics, cameras.c2w)[0]
    one = Judged(
        scene=folder.name,
        gaussians=run.gaussians,
        signals=signals,
        shown=contributions,
        cameras=cameras,
        error=sampled(wrong.abs().mean(1)),
        alpha=sampled(alphas),
        plain={
            "not covered (1 - alpha)": sampled(1 - alphas),
            "angle to the nearest photo": sampled(angles(points, cameras, run.cameras)),
        },
    )
    lonely = (photos_of(contributions) <= 1).float()
    contrast = signals[:, 0] - signals[:, 0].min()
    for name, numbers in (
        ("shown by one photo only", lonely),
        ("contrast of the photos alone", contrast / contrast.max()),
    ):
        one.plain[name] = one.rendered(numbers) + 1 - one.alpha
    return one


def held_out(
    found: Cameras, views: edit3r.Views, placed: list[int], count: int
) -> tuple[Cameras, list[int]]:
    """Cameras of the photos from `count` on whose nearest photo was placed, and which they are."""
    true = views.c2w[0].double()
    own = found.c2w[0].double()
    known = torch.pdist(true[placed, :3, 3]).sum()
    unit = torch.pdist(own[:, :3, 3]).sum() / known
    poses, shown = [], []
    for target in range(count, views.count):
        steps = (true[:count, :3, 3] - true[target, :3, 3]).norm(dim=1)
        nearest = int(steps.argmin())
        if nearest in placed:
            step = torch.linalg.inv(true[nearest]) @ true[target]
            step[:3, 3] *= unit
            poses.append((own[placed.index(nearest)] @ step).float())
            shown.append(target - count)
    intrinsics = views.intrinsics[:, count:][:, shown]
    return Cameras(torch.stack(poses)[None], intrinsics, views.image_size), shown


def angles(points: Tensor, cameras: Cameras, photos: Cameras) -> Tensor:
    """Angle at each point `[camera, H, W, 3]` between its camera and the nearest photo."""

    def directions(centres: Tensor) -> Tensor:
        return F.normalize(points - centres, dim=-1)

    own = directions(cameras.c2w[0, :, None, None, :3, 3])
    cosines = [(own * directions(c2w[:3, 3])).sum(-1) for c2w in photos.c2w[0]]
    return torch.stack(cosines).amax(0).clamp(-1, 1).acos()


def for_fitting(sets: Sequence[Judged]) -> list[Judged]:
    """All but the scenes that are held out of every choice."""
    return [one for one in sets if one.scene not in HELD_OUT]


def fitted(sets: Sequence[Judged]) -> tuple[Tensor, float]:
    """Factors and constant that fit the pixels of `sets` best; each set counts the same."""
    signals = torch.cat([one.pixels for one in sets])
    alpha = torch.cat([one.alpha.flatten() for one in sets])
    error = [one.error.flatten() for one in sets]
    truth = (torch.cat(error) > WRONG).float()
    weight = torch.cat(
        [torch.full_like(own, 1 / len(own) / len(sets)) for own in error]
    )
    centre = signals.mean(0)
    spread = signals.std(0).clamp(min=1e-6)
    signals = (signals - centre) / spread
    theta = torch.zeros(signals.shape[1] + 1, requires_grad=True)
    optimiser = torch.optim.LBFGS([theta], max_iter=60)

    def loss() -> Tensor:
        optimiser.zero_grad()
        share = (signals @ theta[1:] + theta[0]).sigmoid()
        promise = (share * alpha + 1 - alpha).clamp(1e-5, 1 - 1e-5)
        value = F.binary_cross_entropy(promise, truth, weight, reduction="sum")
        value.backward()
        return value

    with torch.enable_grad():
        optimiser.step(loss)
    theta = theta.detach()
    factors = theta[1:] / spread
    return factors, float(theta[0] - factors @ centre)


def report(sets: Sequence[Judged], given: tuple[Tensor, float] | None) -> None:
    """Print a line a set, the means, and the bins."""
    guesses = ("uncertainty", *sets[0].plain)
    print(f"| set | {' | '.join(guesses)} |")
    print(f"| --- |{' --: |' * len(guesses)}")
    promises, truths, figures = [], [], []
    for one in sets:
        rest = [other for other in for_fitting(sets) if other.scene != one.scene]
        number = probability(one.signals, one.shown, *(given or fitted(rest)))
        scene = replace(one.gaussians, uncertainty=number)
        promise = sampled(render_uncertainty(RASTERIZER, scene, one.cameras)[0])
        figures.append(
            [scores(guess, one.error) for guess in (promise, *one.plain.values())]
        )
        cells = [f"{rank:.2f}, {area:.2f}" for rank, area in figures[-1]]
        print(f"| {one.scene} | {' | '.join(cells)} |", flush=True)
        promises.append(promise.flatten())
        truths.append((one.error > WRONG).float().flatten())
    means = np.mean(figures, 0)
    cells = [f"{rank:.3f}, {area:.3f}" for rank, area in means]
    print(f"| mean of {len(sets)} | {' | '.join(cells)} |")
    promise, truth = torch.cat(promises), torch.cat(truths)
    print("\n| promised | came true |\n| --: | --: |")
    for own in promise.argsort().chunk(BINS):
        print(f"| {promise[own].mean():.3f} | {truth[own].mean():.3f} |")


def scores(guess: Tensor, error: Tensor) -> tuple[float, float]:
    """Rank correlation with the error, and the area of the sparsification curve; means of views."""
    ranks = [spearmanr(*pair)[0] for pair in zip(guess, error)]
    areas = [area(*pair) for pair in zip(guess, error)]
    return float(np.nan_to_num(ranks).mean()), float(np.mean(areas))


def area(guess: Tensor, error: Tensor) -> float:
    """0: the pixels leave in the order of their error; 1: in any order.

    Pixels with the same guess leave in the order of a seeded shuffle.
    """
    mixed = torch.randperm(len(error), generator=torch.Generator().manual_seed(0))
    guess = guess[mixed]
    error = error[mixed].double()

    def mean_kept(order: Tensor) -> Tensor:
        kept = torch.arange(1, len(order) + 1)
        return (error[order].cumsum(0) / kept).mean()

    oracle = mean_kept(error.argsort())
    own = mean_kept(guess.argsort(stable=True))
    return float((own - oracle) / (error.mean() - oracle))


if __name__ == "__main__":
    main()
