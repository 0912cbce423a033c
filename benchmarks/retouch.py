"""Is what `retouch` shows behind a removed object true? Generated scenes whose object can really be
taken away.

    python benchmarks/retouch.py --scenes 24 --size 128

Rims: mean absolute error in the ring of 5 pixels around masks that are 2 pixels too small.
PSNR [dB] over the pixels of the holes, against the rendered truth: of a smooth filling of each
photo alone, of `retouch`, and of `retouch` given the true depths; once where another photo sees
behind the object (points of its true depths fall there), once over whole holes. Scenes whose photos
cannot be matched are counted.
"""

import argparse

import numpy as np
import torch
from edit3r_editors.retouch import behind

import edit3r
from edit3r.contract.errors import MatchingError
from edit3r.contract.interfaces import Geometry
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.geometry.cameras import project, unproject
from edit3r.kit.geometry.maps import dilate

RING = 5  # width of the ring around a mask [pixels]


def psnr(image: torch.Tensor, truth: torch.Tensor, where: torch.Tensor) -> float:
    """Of the pixels in `where` [view height width]; images [view 3 height width]."""
    error = ((image - truth) ** 2).mean(1)[where].mean()
    return float(-10 * torch.log10(error.clamp(min=1e-10)))


def seen_behind(holes: torch.Tensor, depths: torch.Tensor, cameras) -> torch.Tensor:
    """Pixels of the holes [view height width] where another view's points fall that are no part of
    what is removed.
    """
    intrinsics, c2w, (height, width) = (
        cameras.intrinsics[0],
        cameras.c2w[0],
        holes.shape[-2:],
    )
    points, kept, seen = (
        unproject(depths, intrinsics, c2w),
        dilate(holes.float(), 2) == 0,
        torch.zeros_like(holes),
    )
    for view in range(len(holes)):
        others = [o for o in range(len(holes)) if o != view]
        lent = torch.cat([points[o][kept[o]] for o in others])
        places, z = project(lent, intrinsics[view], c2w[view])
        column, row = (places * torch.tensor([width, height])).floor().long().unbind(-1)
        inside = (
            (z > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        )
        seen[view][row[inside], column[inside]] = True
    return (dilate(seen.float(), 1) > 0) & holes


def rim_errors(
    editor, views: Views, changed: torch.Tensor, truth: torch.Tensor
) -> list[float]:
    """Mean absolute errors in the ring around masks that are 2 pixels too small.

    Of the photos, of `retouch` confined to these masks, and of `retouch` with the rims and shadows
    it asks for.
    """
    tight = (-dilate(-changed.float(), 2))[None]
    wide = editor.widened(tight[None], views.images)[0]
    ring = ((dilate(tight, RING) > 0) & (tight == 0))[0]
    results = [views.images]
    for masks in (tight, wide):
        edited = editor.edit(views, EditRequest("", 0, masks)).images
        results.append(torch.where(masks[:, :, None] > 0, edited, views.images))
    return [float((one[0] - truth).abs().mean(1)[ring].mean()) for one in results]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=int, default=24)
    parser.add_argument(
        "--size", type=int, default=128, help="side of the images [pixels]"
    )
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--seed", type=int, default=77)
    options = parser.parse_args()
    settings = {
        "image_size": options.size,
        "context": options.views,
        "edit": "remove",
        "seed": options.seed,
        "angles": [8, 25],
    }
    data = edit3r.build("dataset", "procedural", **settings)
    editor = edit3r.build("editor", "retouch")
    rows, rims = [], []
    lost = 0
    for index in range(options.scenes):
        sample = data[index]
        changed = (sample.context != sample.edited_context).any(1)
        holes = dilate(changed.float(), 1) > 0
        cameras = sample.context_cameras
        views = Views(
            sample.context[None],
            cameras.intrinsics,
            tuple(map(str, range(options.views))),
        )
        truth = Geometry(
            cameras.c2w, sample.context_depths[None], torch.ones_like(sample.context_depths)[None],
            torch.ones(1, options.views, dtype=torch.bool),
        )  # fmt: skip
        seen = seen_behind(holes, sample.context_depths, cameras)
        if int(seen.sum()) < 50:
            continue
        try:
            editor.matcher.match(views)
        except MatchingError:
            lost += 1
            continue
        retouched = editor.edit(views, EditRequest("", 0, holes[None].float())).images[
            0
        ]
        alone = torch.stack(
            [_alone(editor, *one) for one in zip(views.images[0], holes)]
        )
        best, carried = behind(views, holes, truth, 0, 2)
        best = torch.stack(
            [_alone(editor, *one) for one in zip(best, holes & ~carried)]
        )
        rows.append([psnr(image, sample.edited_context, where)
                     for where in (seen, holes) for image in (alone, retouched, best)])  # fmt: skip
        rims.append(rim_errors(editor, views, changed, sample.edited_context))
        print(
            f"{sample.name:20} hole {float(holes.float().mean()):.3f} seen "
            f"{float(seen[holes].float().mean()):.2f}",
            *(f"{v:.1f}" for v in rows[-1]),
        )
    print(
        "error within {} pixels of masks that are 2 too small [1/255]: photo {:.1f}, "
        "retouch in the mask alone {:.1f}, with rim and shadow {:.1f}".format(
            RING, *(255 * np.nanmean(rims, 0))
        )
    )
    means, gains = np.mean(rows, 0), np.array(rows)[:, 1] - np.array(rows)[:, 0]
    told = [
        f"inpainting {a:.2f}, retouch {b:.2f}, with true depths {c:.2f} dB"
        for a, b, c in (means[:3], means[3:])
    ]
    print(f"{len(rows)} scenes, {lost} not matched; where another photo sees behind: {told[0]} "
          "(better in "
          f"{(gains > 0).sum()} scenes, median gain {np.median(gains):.2f}); whole holes: "
          f"{told[1]}")  # fmt: skip


def _alone(editor, image, hole):
    from edit3r_editors.retouch import _inpainted

    return _inpainted(image, hole)


if __name__ == "__main__":
    main()
