"""Does a dearer preset show views that were not given better? Ten wide pairs of real photos.

    python benchmarks/dial.py photos/ --presets fast default best
    python benchmarks/dial.py photos/ --only "fox 25,29" --poses known

A row a pair: the photo between the two, at 512 pixels, as each preset shows it (`default`: none):
PSNR [dB] at its true pose, then PSNR and SSIM where the scene shows it best: poses of a pair are
off by a fraction of a degree, and a sharp picture beside its place loses more than a soft one.
`--poses known` gives the run the true poses of its photos too.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import torch
import torch.nn.functional as F
from edit3r_measure.protocol import align
from harness import Row, run_benchmark
from lenses import MATCHER
from verdict import between, unseen_camera

import edit3r
from edit3r.kit.compute.likeness import psnr, ssim
from edit3r.kit.photos.posed_folder import read_posed_folder
from edit3r.running.quality import read_quality

PAIRS = (
    *(
        "fern 10,14",
        "fox 25,29",
        "monstree 0,2",
        "dinosaur 31,34",
        "7scenes_rgbd 12,14",
    ),
    *("bear 0,2", "fern 0,4", "fox 0,8", "dinosaur 0,1", "fox 36,38"),
)
FULL = 512  # long side of the photos between [pixels]
STEPS, RATE = 40, 0.0005  # that bring a camera to where the scene shows its photo best

Figures = tuple[float, float, float]  # PSNR, PSNR and SSIM where it is shown best


def main(
    data: Path,
    *,
    presets: Sequence[str] = ("fast", "balanced", "default", "best"),
    only: Sequence[str] = PAIRS,
    poses: str = "unknown",
) -> Iterator[Row]:
    shown: dict[str, list[Figures]] = {preset: [] for preset in presets}
    for pair in only:
        scene, _, numbers = pair.partition(" ")
        chosen = [int(number) for number in numbers.split(",")]
        for preset, figures in shown.items():
            figures.append(measure(data / scene, chosen, preset, poses == "known"))
        yield {"photos": pair, **{name: cell(own[-1:]) for name, own in shown.items()}}
    yield {"photos": "mean", **{name: cell(own) for name, own in shown.items()}}


def cell(figures: Sequence[Figures]) -> str:
    at_its_pose, aligned, likeness = np.mean(figures, axis=0)
    return f"{at_its_pose:.2f}, {aligned:.2f}, {likeness:.3f}"


def measure(folder: Path, chosen: list[int], preset: str, known: bool) -> Figures:
    """Means over the photos between the chosen ones."""
    cameras = read_posed_folder(folder).cameras
    centres = np.stack([camera.c2w[:3, 3] for camera in cameras])
    targets = [target for target in between(centres, chosen) if target is not None]
    files = [folder / cameras[index].file for index in (*chosen, *targets)]
    whole, count = edit3r.load_views(files, size=FULL), len(chosen)
    quality = None if preset == "default" else preset
    size = read_quality().preset(quality).settings["size"] if quality else FULL
    given = edit3r.load_views(files[:count], size=size)
    posed = whole.c2w[:, :count] if known else None
    options = {"matcher": posed_matcher(quality)}
    result = edit3r.run(
        replace(given, c2w=posed),
        editor="none",
        outputs=[],
        quality=quality,
        **options if known else {},
    )
    figures = [compared(result, whole, view) for view in range(count, whole.count)]
    return tuple(np.mean(figures, axis=0))


def compared(result: edit3r.RunResult, whole: edit3r.Views, target: int) -> Figures:
    """How view `target` is shown from its true pose, and from where it is shown best."""
    placed = [view for view, there in enumerate(result.verdict.placed) if there]
    camera = unseen_camera(result, whole, placed, target)
    photo, scene = whole.images[:, [target]], in_unit(result)
    best = align(scene, camera, photo, F.mse_loss, STEPS, RATE)
    true = as_numpy(photo)
    first, last = (
        as_numpy(result.rasterizer.render(result.gaussians, place).images.clamp(0, 1))
        for place in (camera, best)
    )
    return psnr(first, true), psnr(last, true), ssim(last, true)


def in_unit(result: edit3r.RunResult) -> SimpleNamespace:
    """The scene as `align` takes it, its unit of length the distance of the first two cameras."""
    cameras = result.cameras.c2w[0]
    pose = (torch.linalg.inv(cameras[0]) @ cameras[1]).numpy()
    made = SimpleNamespace(gaussians=result.gaussians)
    return SimpleNamespace(
        predicted_pose=pose, rasterizer=result.rasterizer, reconstruction=made
    )


def as_numpy(image: torch.Tensor) -> np.ndarray:
    return image[0, 0].permute(1, 2, 0).numpy()


def posed_matcher(quality: str | None) -> dict:
    """The matcher that trusts poses, as fine as that of the preset."""
    chosen = read_quality().preset(quality).settings if quality else {}
    return {**MATCHER, **chosen.get("matcher", {}), "name": "posed"}


if __name__ == "__main__":
    run_benchmark(main)
