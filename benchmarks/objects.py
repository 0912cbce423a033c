"""Objects of a finished scene: found by masks, and drawn over it.

python benchmarks/objects.py masks|drawn --help
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
from edit3r_objects.drawn import Drawn, choose_drawn
from edit3r_objects.lifting import lift
from edit3r_objects.run import read_run
from harness import run_benchmark
from PIL import Image
from torch import Tensor

import edit3r
from edit3r import Cameras, Gaussians, build
from edit3r.cli.main import main as program
from edit3r.contract.errors import Edit3rError, InputError
from edit3r.contract.interfaces import Selection
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.geometry.cameras import pixel_scales, pixels_to_gaussians
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r.kit.geometry.paths import interpolate_poses
from edit3r.kit.rendering import render_numbers
from edit3r.kit.segmenting import automatic_masks
from edit3r.running import read_earlier_run, usual_selector

# ---- masks ----

EDITS = (
    "remove thing",
    "move thing 0.1 0 0",
    "turn thing 20",
    "scale thing 1.2",
    "recolor thing blue",
    "copy thing second 0.2 0 0",
    "isolate thing",
)


def masks() -> None:
    """How well a mask of one photo becomes an object of the scene, and how long edits of it take.

        python benchmarks/objects.py masks DATA [--only bear fox] [--made 10]

    DATA is a folder of photo sets. For each object of `clicks.json` with two photos the pair is
    reconstructed, the outline drawn by hand on the first photo is lifted to Gaussians, and these
    are rendered in the second, whose outline is not used but to compare: IoU. Then each edit is
    timed, with reading and writing, in one process. `--made` does the same with made scenes and
    exact masks.
    """
    parser = argparse.ArgumentParser(description=masks.__doc__.splitlines()[0])
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


# ---- drawn ----

AREAS = 0.01, 0.35  # of a thing on its photo
APART = 0.2  # overlap of two things, at most
PIECE = 0.05  # share of the outline's area from which a piece gets a lasso of its own
BRUSH = 0.02  # its radius, at most [longer sides]
NARROW = (
    1 / 3
)  # its radius, at most [of how far the thing reaches from its middle to its rim]


def things(run, segmenter, most):
    """Masks on all photos of the things that all photos show."""
    photos = run.photos
    found = []
    for proposal in automatic_masks(segmenter, photos.images[0, 0]):
        mask = proposal.soft_mask > 0.5
        area = float(mask.float().mean())
        overlaps = [
            float((mask & one).sum() / min(mask.sum(), one.sum())) for one in found
        ]
        if AREAS[0] < area < AREAS[1] and max(overlaps, default=0) < APART:
            found.append(mask)
    selector = usual_selector(segmenter)
    for mask in found[:most]:
        with collecting(Report()):
            selected = selector.select(photos, Selection(masks={0: mask.float()}))
        masks = selected.masks[:, 0]
        if (masks.flatten(1).amax(1) > 0.5).all():
            yield masks


def between(cameras):
    """The camera halfway between the first two."""
    first, second = cameras.c2w[0, :2].double()
    c2w = interpolate_poses(first, second, torch.tensor(0.5).double()).float()
    return Cameras(
        c2w.reshape(1, 1, 4, 4), cameras.intrinsics[:, :1], cameras.image_size
    )


def stroke(kind, places, camera, radius=BRUSH):
    """A stroke through places in pixels."""
    height, width = camera.image_size
    axes = camera.c2w[0, 0, :3].T.tolist()
    lens = camera.intrinsics[0, 0]
    fx, fy, cx, cy = (float(lens[k]) for k in ((0, 0), (1, 1), (0, 2), (1, 2)))
    shares = [(float(x) / width, float(y) / height) for x, y in places]
    return Drawn(kind, shares, *axes, (fx, fy, cx, cy), width / height, radius)


def lassos(shape, stray, camera):
    """Around every larger piece of a picture of 0 and 1."""
    reach = max(1, round(stray * max(shape.shape)))
    wide = cv2.dilate(shape, np.ones((2 * reach + 1,) * 2, np.uint8))
    lines, _ = cv2.findContours(wide, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    for line in lines:
        if cv2.contourArea(line) > PIECE * wide.sum():
            rough = cv2.approxPolyDP(line, 0.006 * max(shape.shape), True)
            yield stroke("lasso", rough[:, 0], camera)


def brushes(shape, camera):
    """Level strokes that cover the inside, half a brush from its outline."""
    depth = cv2.distanceTransform(shape, cv2.DIST_L2, 5)
    radius = min(BRUSH * max(shape.shape), NARROW * float(depth.max()))
    inside = depth > 0.7 * radius
    for row in range(0, shape.shape[0], max(1, round(radius))):
        columns = np.nonzero(inside[row])[0]
        for part in np.split(columns, np.nonzero(np.diff(columns) > 1)[0] + 1):
            if len(part):
                places = [(part[0], row), (part[-1], row)]
                yield stroke("brush", places, camera, radius / max(shape.shape))


@torch.no_grad()
def drawn():
    """How much of a thing a lasso, or a brush, over the finished scene takes.

        python benchmarks/objects.py drawn RUN... [--stray 0.008] [--most 3]

    Each RUN is the folder of a run. Things are what the segmenter proposes on the first photo,
    found again on the others; their Gaussians by masks on all photos are the truth. From halfway
    between the first two cameras, where no photo was taken, a lasso is drawn around what the thing
    covers there, `stray` outside of its outline, and a brush over its inside. IoU of the Gaussians;
    things that another photo does not show again are left out, as they have no truth.
    """
    parser = argparse.ArgumentParser(description=drawn.__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", metavar="RUN")
    parser.add_argument("--stray", type=float, default=0.008, help="[longer sides]")
    parser.add_argument("--most", type=int, default=3, help="things of a run")
    args = parser.parse_args()
    rasterizer, segmenter = build("rasterizer", "auto"), build("segmenter", "auto")
    found = []
    for folder in args.runs:
        run = read_earlier_run(folder)
        scene, cameras = run.scene.gaussians, run.scene.cameras
        camera = between(cameras)
        for masks in things(run, segmenter, args.most):
            truth = lift(scene, cameras, masks, rasterizer)
            flags = render_numbers(rasterizer, scene, truth[None], camera).images
            shape = (flags[0, 0, 0] > 0.5).numpy().astype(np.uint8)
            row = []
            for strokes in (lassos(shape, args.stray, camera), brushes(shape, camera)):
                taken = choose_drawn(scene, list(strokes)[:200], rasterizer)
                row.append(float((taken & truth).sum() / (taken | truth).sum()))
            found.append(row)
            area = float((masks[0] > 0.5).float().mean())
            print(
                f"{Path(folder).name:16s} {area:5.1%} of the photo   "
                f"lasso {row[0]:.2f}   brush {row[1]:.2f}",
                flush=True,
            )
    for name, values in zip(("lasso", "brush"), zip(*found)):
        good = sum(value >= 0.8 for value in values)
        print(f"{name}: median {np.median(values):.2f}, {good} of {len(values)} >= 0.8")


if __name__ == "__main__":
    run_benchmark(masks, drawn)
