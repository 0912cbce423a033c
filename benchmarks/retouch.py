"""Is what `retouch` shows behind a removed object true? Generated scenes whose object can really be taken away.

    python benchmarks/retouch.py --scenes 24 --size 128

PSNR [dB] over the pixels of the holes, against the rendered truth: of OpenCV's inpainting of each photo alone, and of
`retouch`, once where the other photo sees behind the object (by the true depths), once over whole holes. Scenes whose
photos cannot be matched are counted.
"""

import argparse

import numpy as np
import torch
from edit3r_editors.retouch import behind

import edit3r
from edit3r.errors import MatchingError
from edit3r.geometry.maps import dilate
from edit3r.interfaces import MatchedGeometry
from edit3r.types import EditRequest, Views


def psnr(image: torch.Tensor, truth: torch.Tensor, where: torch.Tensor) -> float:
    """Of the pixels in `where` [view height width]; images [view 3 height width]."""
    error = ((image - truth) ** 2).mean(1)[where].mean()
    return float(-10 * torch.log10(error.clamp(min=1e-10)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=24)
    parser.add_argument("--size", type=int, default=128, help="side of the images [pixels]")
    parser.add_argument("--views", type=int, default=2)
    options = parser.parse_args()
    settings = {"image_size": options.size, "context": options.views, "edit": "remove", "seed": 77, "angles": [8, 25]}
    data = edit3r.build("dataset", "procedural", **settings)
    editor = edit3r.build("editor", "retouch")
    rows, lost = [], 0
    for index in range(options.scenes):
        sample = data[index]
        changed = (sample.context != sample.edited_context).any(1)
        holes = dilate(changed.float(), 1) > 0
        cameras = sample.context_cameras
        views = Views(sample.context[None], cameras.intrinsics, tuple(map(str, range(options.views))))
        truth = MatchedGeometry(
            cameras.c2w, sample.context_depths[None], torch.ones_like(sample.context_depths)[None],
            torch.ones(1, options.views, dtype=torch.bool),
        )  # fmt: skip
        _, seen = behind(views, holes, truth, 0, 2)
        if int(seen.sum()) < 50:
            continue
        try:
            editor.matcher.match(views)
        except MatchingError:
            lost += 1
            continue
        retouched = editor.edit(views, EditRequest("", 0, holes[None].float())).images[0]
        alone = torch.stack([_alone(editor, *one) for one in zip(views.images[0], holes)])
        rows.append(
            [psnr(image, sample.edited_context, where) for where in (seen, holes) for image in (alone, retouched)]
        )
        print(
            f"{sample.name:20} hole {float(holes.float().mean()):.3f} seen {float(seen[holes].float().mean()):.2f}",
            *(f"{v:.1f}" for v in rows[-1]),
        )
    means = np.mean(rows, 0)
    print(f"{len(rows)} scenes, {lost} not matched; where the other photo sees behind: inpainting {means[0]:.2f}, "
          f"retouch {means[1]:.2f} dB; whole holes: {means[2]:.2f}, {means[3]:.2f} dB")  # fmt: skip


def _alone(editor, image, hole):
    from edit3r_editors.retouch import _inpainted

    return _inpainted(image, hole, editor.settings.radius)


if __name__ == "__main__":
    main()
