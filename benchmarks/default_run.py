"""What the default run costs and shows at several sizes, beside the run without refiners.

    python benchmarks/default_run.py FOLDER:FIRST,SECOND ... --settings 512 384 512:plain

Each scene is a folder with photos and a cameras.json and the numbers of two photos; poses are not
used. `plain` stands for `--gaussians all --refine 0`. A row a run: processor seconds from images
to Gaussians, of 36 frames of the camera path (from six of them), Gaussians; PSNR, SSIM, LPIPS and
share of detail of the photos and of the one half-way at 512 pixels, whatever the size of the run.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from dial import as_numpy, at_the_photos, drawn as image_of
from harness import Row, run_benchmark
from likeness import TITLE, likeness
from verdict import unseen_camera

import edit3r
from edit3r.kit.photos.posed_folder import read_posed_folder
from edit3r.kit.rendering import path_around, render_one

FRAMES, DRAWN, FULL = 36, 6, 512


def measure(files: list[Path], between: Path, size: int, plain: bool) -> Row:
    views = replace(edit3r.load_views(files, size=size), c2w=None)
    start = time.process_time()
    result = edit3r.run(
        views, editor="none", **({"gaussians": "all", "refine": 0} if plain else {})
    )
    made = time.process_time() - start
    path = path_around(result.cameras, result.rendered, FRAMES)
    start = time.process_time()
    with torch.no_grad():
        for frame in range(0, FRAMES, FRAMES // DRAWN):
            render_one(result.rasterizer, result.gaussians, path.select([frame]))
    drawn = (time.process_time() - start) * FRAMES / DRAWN
    full = edit3r.load_views([*files, between], size=FULL)
    camera = unseen_camera(result, full, [0, 1], 2)
    half_way = likeness(image_of(result, camera), as_numpy(full, 2))
    return {
        "made in, CPU s": (made, ".2f"),
        "36 frames, CPU s": (drawn, ".2f"),
        "Gaussians": (result.gaussians.count, ",d"),
        f"photos: {TITLE}": str(at_the_photos(result, full)),
        "half-way": str(half_way),
        "verdict": result.verdict.label,
    }


def main(
    scenes: Sequence[str],
    *,
    settings: Sequence[str] = ("512:plain", "512", "384", "320"),
) -> Iterator[Row]:
    for scene in scenes:
        folder, _, numbers = scene.rpartition(":")
        first, second = map(int, numbers.split(","))
        cameras = read_posed_folder(Path(folder)).cameras
        files = [
            Path(folder) / cameras[i].file
            for i in (first, second, (first + second) // 2)
        ]
        for setting in settings:
            size, _, plain = setting.partition(":")
            figures = measure(files[:2], files[2], int(size), plain == "plain")
            name = f"{Path(folder).name} {first}, {second}"
            yield {"scene and photos": name, "pixels": setting, **figures}


if __name__ == "__main__":
    run_benchmark(main)
