"""A stand-in for a program, without edit3r: every photo becomes a wall two units away, a Gaussian a
pixel.
"""

import json
import math
import sys
from pathlib import Path

import numpy as np
from PIL import Image

COLUMNS = (
    *("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)

photos, result = map(Path, sys.argv[1:])
walls, cameras = [], []
for index, photo in enumerate(sorted(photos.iterdir())):
    colours = np.asarray(Image.open(photo).convert("RGB"), dtype=np.float32) / 255
    height, width = colours.shape[:2]
    focal = 0.5 * width / math.tan(0.45)  # [pixels]
    rows, columns = np.mgrid[:height, :width] + 0.5
    wall = np.zeros((height, width, len(COLUMNS)), np.float32)
    # the cameras stand side by side
    wall[..., 0] = 2 * (columns - width / 2) / focal + 0.1 * index
    wall[..., 1] = 2 * (rows - height / 2) / focal
    wall[..., 2] = 2
    wall[..., 3:6] = (colours - 0.5) / 0.28209479  # harmonics of degree 0
    wall[..., 6] = 2.2  # a logit: nine tenths
    wall[..., 7:10] = math.log(1 / focal)
    wall[..., 10] = 1  # not turned
    walls.append(wall.reshape(-1, len(COLUMNS)))
    c2w = np.eye(4)
    c2w[0, 3] = 0.1 * index
    lens = [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]
    cameras.append(
        {
            "file": photo.name,
            "width": width,
            "height": height,
            "K": lens,
            "c2w": c2w.tolist(),
        }
    )

gaussians = np.concatenate(walls)
header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(gaussians)}"]
header += [*(f"property float {name}" for name in COLUMNS), "end_header", ""]
(result / "scene.ply").write_bytes("\n".join(header).encode() + gaussians.tobytes())
(result / "cameras.json").write_text(json.dumps(cameras))
