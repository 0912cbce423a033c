"""How much of a thing a lasso, or a brush, over the finished scene takes.

    python benchmarks/drawn.py RUN... [--stray 0.008] [--most 3]

Each RUN is the folder of a run. Things are what the segmenter proposes on the first photo, found
again on the others; their Gaussians by masks on all photos are the truth. From halfway between the
first two cameras, where no photo was taken, a lasso is drawn around what the thing covers there,
`stray` outside of its outline, and a brush over its inside. IoU of the Gaussians; things that
another photo does not show again are left out, as they have no truth.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
import torch
from edit3r_objects.drawn import Drawn, choose_drawn
from edit3r_objects.lifting import lift

from edit3r import Cameras, build
from edit3r.contract.interfaces import Selection
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.geometry.paths import interpolate_poses
from edit3r.kit.rendering import render_numbers
from edit3r.running import read_earlier_run, usual_selector

AREAS = 0.01, 0.35  # of a thing on its photo
APART = 0.2  # overlap of two things, at most
PIECE = 0.05  # share of the outline's area from which a piece gets a lasso of its own
BRUSH = 0.02  # radius [longer sides]


def things(run, segmenter, most):
    """Masks on all photos of the things that all photos show."""
    photos = run.photos
    found = []
    for proposal in segmenter.propose(photos.images[0, 0]):
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


def stroke(kind, places, camera):
    """A stroke through places in pixels."""
    height, width = camera.image_size
    axes = camera.c2w[0, 0, :3].T.tolist()
    lens = camera.intrinsics[0, 0]
    fx, fy, cx, cy = (float(lens[k]) for k in ((0, 0), (1, 1), (0, 2), (1, 2)))
    shares = [(float(x) / width, float(y) / height) for x, y in places]
    return Drawn(kind, shares, *axes, (fx, fy, cx, cy), width / height, BRUSH)


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
    radius = BRUSH * max(shape.shape)
    inside = cv2.distanceTransform(shape, cv2.DIST_L2, 5) > 0.7 * radius
    for row in range(0, shape.shape[0], max(1, round(radius))):
        columns = np.nonzero(inside[row])[0]
        for part in np.split(columns, np.nonzero(np.diff(columns) > 1)[0] + 1):
            if len(part):
                yield stroke("brush", [(part[0], row), (part[-1], row)], camera)


@torch.no_grad()
def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
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
            for drawn in (lassos(shape, args.stray, camera), brushes(shape, camera)):
                taken = choose_drawn(scene, list(drawn)[:200], rasterizer)
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
    main()
