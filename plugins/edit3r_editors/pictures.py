"""Between view tensors and picture files: what the `folder` and `command` editors share."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r import reporting
from edit3r.io.framing import frame_for
from edit3r.io.images import read_image, save_image
from edit3r.types import Views


def view_names(views: Views) -> list[str]:
    """One distinct file stem per view: its name where it has one, else `view_1`, `view_2`, ..."""
    if not views.names:
        return [f"view_{index + 1}" for index in range(views.count)]
    stems = [Path(name).stem for name in views.names]
    return stems if len(set(stems)) == len(stems) else [f"{stem}_{index + 1}" for index, stem in enumerate(stems)]


def write_picture(path: Path, image: Float[Tensor, "3 height width"]) -> None:
    """Write a picture as PNG."""
    save_image(image, path)


def write_mask(path: Path, mask: Float[Tensor, "height width"]) -> None:
    """Write a mask as PNG of equal channels: white may change."""
    save_image(mask.expand(3, -1, -1), path)


def read_picture(path: Path, like: Float[Tensor, "3 height width"], name: str) -> Float[Tensor, "3 height width"]:
    """Read the edit of view `name` at the size, dtype and device of `like`.

    Another size is framed as photos are when they are loaded: scaled to cover, cropped around the middle. So an edit
    of the original photo lands where the photo did.
    """
    picture = read_image(path)
    height, width = like.shape[-2:]
    frame = frame_for((picture.height, picture.width), (height, width))
    if frame.cropped > 0.01:
        reporting.warn(
            f"{path.name} is {picture.width}x{picture.height} but view {name!r} is {width}x{height}: of it "
            f"{frame.cropped:.0%} is cropped away. Right for an edit of the whole photo if that was cropped too."
        )
    pixels = np.array(frame.cut(picture), dtype=np.float32) / 255
    return torch.from_numpy(pixels).permute(2, 0, 1).to(like)
