"""Pictures of an edited scene from those of the scene before: only the part that can differ is drawn."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.io.decode import read_image
from edit3r.reuse.crop import boxes_of, cropped
from edit3r.reuse.graft import differing, same_structure
from edit3r.reuse.state import SceneState, frame_file, hash_of
from edit3r.types import Cameras, Gaussians, Rendering

Render = Callable[[Cameras], Rendering]
Picture = Float[Tensor, "3 height width"]


def earlier_frames(earlier: SceneState, count: int, rasterizer: str) -> list[Picture] | None:
    """The frames of the earlier run's camera path; None unless they are as it left them and show its whole scene.

    `count` is how many are asked for, `rasterizer` the identity of what would draw them.
    """
    if not earlier.drawn.whole or earlier.drawn.rasterizer != rasterizer or earlier.path.count != count:
        return None
    files = [frame_file(earlier.root / "renders", index) for index in range(count)]
    if [hash_of(file) for file in files] != list(earlier.drawn.frames):
        return None
    return [torch.from_numpy(np.array(read_image(file))).permute(2, 0, 1) / 255 for file in files]


def redraw(before: Sequence[Picture], changed: Gaussians, cameras: Cameras, render: Render) -> Iterator[Picture]:
    """One picture per camera: `before`, drawn anew inside the box that the `changed` Gaussians, old and new, reach.

    `before` may have been rounded to eight bits; then so are the parts that stay, and the seam is below half a step.
    """
    for index, (picture, box) in enumerate(zip(before, boxes_of(changed, cameras))):
        if box is None:
            yield picture
            continue
        top, left, bottom, right = box
        picture = picture.clone()
        picture[:, top:bottom, left:right] = render(cropped(cameras.select([index]), box)).images[0, 0].to(picture)
        yield picture


def changed_between(before: Gaussians, after: Gaussians) -> Gaussians | None:
    """Gaussians of either scene that the other lacks; None where that cannot be told (another number, or order)."""
    if not same_structure(before, after):
        return None
    differs = differing(before, after)
    return Gaussians.cat((before.select(differs), after.select(differs)))
