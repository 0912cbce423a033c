"""Does a dearer preset show more? Ten wide pairs of real photos, at the photos and between them.

    python benchmarks/dial.py photos/ --presets fast default best
    python benchmarks/dial.py photos/ --only "fox 25,29" --poses known

A row a pair and preset (`default`: none), then the means: CPU seconds of the run, and PSNR [dB],
SSIM, LPIPS and share of detail (benchmarks/likeness.py) at 512 pixels, whatever the preset's size:
of the photos given; of the photo between the two at its true pose; and where the scene shows it
best: poses of a pair are off by a fraction of a degree, and a sharp picture beside its place loses
more than a soft one. `--poses known` gives the run the true poses of its photos too.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import torch
import torch.nn.functional as F
from edit3r_measure.protocol import align
from harness import Row, run_benchmark
from likeness import TITLE, Likeness, likeness, mean
from poses import MATCHER
from verdict import between, unseen_camera

import edit3r
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
FULL = 512  # long side of the photos that are compared [pixels]
STEPS, RATE = 40, 0.0005  # that bring a camera to where the scene shows its photo best

# CPU seconds; photos given, photo between at its true pose, and where it is shown best
Measured = tuple[float, Likeness, Likeness, Likeness]


def main(
    data: Path,
    *,
    presets: Sequence[str] = ("fast", "balanced", "default", "best"),
    only: Sequence[str] = PAIRS,
    poses: str = "unknown",
) -> Iterator[Row]:
    measured: dict[str, list[Measured]] = {preset: [] for preset in presets}
    for pair in only:
        scene, _, numbers = pair.partition(" ")
        chosen = [int(number) for number in numbers.split(",")]
        for preset, own in measured.items():
            own.append(measure(data / scene, chosen, preset, poses == "known"))
            yield cells(pair, preset, own[-1:])
    for preset, own in measured.items():
        yield cells("mean", preset, own)


def cells(pair: str, preset: str, several: Sequence[Measured]) -> Row:
    seconds, *figures = zip(*several)
    titles = (
        f"photos: {TITLE}",
        "between, true pose",
        "between, where shown best",
    )
    return {
        "pair": pair,
        "preset": preset,
        "CPU s": (float(np.mean(seconds)), ".2f"),
        **{title: str(mean(own)) for title, own in zip(titles, figures)},
    }


def measure(folder: Path, chosen: list[int], preset: str, known: bool) -> Measured:
    """Means over the photos given, and over those between them."""
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
    start = time.process_time()
    result = edit3r.run(
        replace(given, c2w=posed),
        editor="none",
        outputs=[],
        quality=quality,
        **options if known else {},
    )
    seconds = time.process_time() - start
    figures = [compared(result, whole, view) for view in range(count, whole.count)]
    shown = [mean(own) for own in zip(*figures)]
    return seconds, at_the_photos(result, whole), *shown


def at_the_photos(result: edit3r.RunResult, whole: edit3r.Views) -> Likeness:
    """How the placed photos of a run, the first of `whole`, are shown at their full size."""
    placed = [view for view, there in enumerate(result.verdict.placed) if there]
    cameras = result.cameras.select(range(len(placed))).at(whole.image_size)
    return mean(
        [
            likeness(drawn(result, cameras.select([camera])), as_numpy(whole, view))
            for camera, view in enumerate(placed)
        ]
    )


def compared(
    result: edit3r.RunResult, whole: edit3r.Views, target: int
) -> tuple[Likeness, Likeness]:
    """How view `target` is shown from its true pose, and from where it is shown best."""
    placed = [view for view, there in enumerate(result.verdict.placed) if there]
    camera = unseen_camera(result, whole, placed, target)
    photo, scene = whole.images[:, [target]], in_unit(result)
    best = align(scene, camera, photo, F.mse_loss, STEPS, RATE)
    true = as_numpy(whole, target)
    first, last = (likeness(drawn(result, place), true) for place in (camera, best))
    return first, last


def in_unit(result: edit3r.RunResult) -> SimpleNamespace:
    """The scene as `align` takes it, its unit of length the distance of the first two cameras."""
    cameras = result.cameras.c2w[0]
    pose = (torch.linalg.inv(cameras[0]) @ cameras[1]).numpy()
    made = SimpleNamespace(gaussians=result.gaussians)
    return SimpleNamespace(
        predicted_pose=pose, rasterizer=result.rasterizer, reconstruction=made
    )


@torch.no_grad()
def drawn(result: edit3r.RunResult, camera: edit3r.Cameras) -> np.ndarray:
    image = result.rasterizer.render(result.gaussians, camera).images
    return image[0, 0].clamp(0, 1).permute(1, 2, 0).numpy()


def as_numpy(views: edit3r.Views, view: int) -> np.ndarray:
    return views.images[0, view].permute(1, 2, 0).numpy()


def posed_matcher(quality: str | None) -> dict:
    """The matcher that trusts poses, as fine as that of the preset."""
    chosen = read_quality().preset(quality).settings if quality else {}
    return {**MATCHER, **chosen.get("matcher", {}), "name": "posed"}


if __name__ == "__main__":
    run_benchmark(main)
