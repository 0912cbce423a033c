"""How well a mask of one photo becomes an object of the scene, and how long edits of it take.

    python benchmarks/objects.py DATA [--only bear fox] [--made 10]

DATA is a folder of photo sets. For each object of `clicks.json` with two photos the pair is
reconstructed, the outline drawn by hand on the first photo is lifted to Gaussians, and these are
rendered in the second, whose outline is not used but to compare: IoU. Then each edit is timed, with
reading and writing, in one process. `--made` does the same with made scenes and exact masks.
"""

import argparse
import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from clicks import filled
from edit3r_objects.lifting import lift
from edit3r_objects.run import read_run
from PIL import Image
from torch import Tensor

import edit3r
from edit3r import Cameras, Gaussians, build
from edit3r.cli.main import main as program
from edit3r.contract.errors import Edit3rError, InputError
from edit3r.kit.geometry.cameras import pixel_scales, pixels_to_gaussians
from edit3r.kit.geometry.harmonics import colour_to_dc

EDITS = (
    "remove thing",
    "move thing 0.1 0 0",
    "turn thing 20",
    "scale thing 1.2",
    "recolor thing blue",
    "copy thing second 0.2 0 0",
    "isolate thing",
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of photo sets")
    parser.add_argument("--only", nargs="*", default=[], help="objects to try")
    parser.add_argument(
        "--made", type=int, default=0, help="made scenes to try as well"
    )
    args = parser.parse_args()
    if args.made:
        print(f"made scenes: {made_scenes(args.made)}", flush=True)
    objects = json.loads(Path(__file__).with_name("clicks.json").read_text())
    for name, photos in objects.items():
        if len(photos) < 2 or (args.only and name not in args.only):
            continue
        with tempfile.TemporaryDirectory() as folder:
            try:
                print(
                    f"{name}: {measured(Path(folder), args.data, photos)}", flush=True
                )
            except Edit3rError as error:
                print(f"{name}: left out, {error}")


def measured(folder: Path, data: Path, photos: dict) -> str:
    """IoU in the second photo, and seconds of each action."""
    files = [data / file for file in photos]
    run, lifted = folder / "run", folder / "lifted"
    mask = folder / "mask.png"
    first, second = (
        filled(outline, Image.open(file).size[::-1])
        for file, outline in zip(files, photos.values())
    )
    Image.fromarray(first).convert("L").save(mask)
    edit3r.run(files, editor="none", outputs=("scene", "images")).save(run)
    times = {"add": act(f"{run} add thing --mask {mask} --out {lifted}")}
    for edit in EDITS:
        action = edit.split()[0]
        times[action] = act(f"{lifted} {edit} --out {folder / action}")
    scene = read_run(lifted)
    shown = coverage(scene.gaussians, scene.chosen("thing"), scene.cameras.select([1]))
    truth = cv2.resize(second.astype(np.float32), shown.shape[:0:-1])
    text = ", ".join(f"{action} {seconds:.1f} s" for action, seconds in times.items())
    return f"IoU {iou(shown[0], torch.from_numpy(truth) > 0.5):.2f}; {text}"


def act(line: str) -> float:
    """Seconds of one `edit3r objects`."""
    start = time.perf_counter()
    if program(["objects", *line.split(), "--quiet"]):
        raise InputError(f"edit3r objects {line} failed")
    return time.perf_counter() - start


def made_scenes(count: int) -> str:
    """Scenes of the dataset `procedural`, a Gaussian a pixel at its true depth: exact masks of two
    views, rendered in views that were not used.
    """
    scores = []
    dataset = build(
        "dataset", "procedural", edit="none", image_size=256, angles=(5, 15)
    )
    for sample in (dataset[index] for index in range(count)):
        cameras = sample.context_cameras
        depths = sample.context_depths.view(1, cameras.count, *cameras.image_size)
        scales = pixel_scales(depths, cameras.intrinsics, 0.5)
        scene = pixels_to_gaussians(
            sample.context[None], depths, cameras, scales, torch.full_like(depths, 0.9)
        )
        rasterizer = build("rasterizer", "auto")
        masks = zip(sample.context_masks, sample.target_masks)
        for inside, held_out in list(masks)[1:]:
            if min(inside.mean((1, 2)).amin(), held_out.mean((1, 2)).amin()) < 0.01:
                continue
            chosen = lift(scene, cameras, inside, rasterizer)
            shown = coverage(scene, chosen, sample.target_cameras)
            scores += [iou(one, mask > 0.5) for one, mask in zip(shown, held_out)]
    if not scores:
        return "no object is large enough"
    middle, least = np.median(scores), np.quantile(scores, 0.1)
    return f"IoU in {len(scores)} views: median {middle:.2f}, worst tenth {least:.2f}"


def coverage(gaussians: Gaussians, chosen: Tensor, cameras: Cameras) -> Tensor:
    """Bool `[C, H, W]`: where the chosen Gaussians are most of what shows."""
    colours = torch.where(chosen, 1.0, 0.0)[None, :, None, None].expand(-1, -1, 1, 3)
    painted = replace(gaussians, harmonics=colour_to_dc(colours).contiguous())
    return build("rasterizer", "auto").render(painted, cameras).images[0, :, 0] > 0.5


def iou(one: Tensor, other: Tensor) -> float:
    return float((one & other).sum() / (one | other).sum().clamp(min=1))


if __name__ == "__main__":
    main()
