"""Depth of a small image for every pixel of a large one."""

import numpy as np
from jaxtyping import Bool, Float

from edit3r.kit.compute.compiling import compiled

# The numbers of this block: no figures kept.
SAME_COLOUR = 0.1  # colour distance [sRGB] at which a small pixel's weight falls to 1/e
# relative difference in inverse depth within which two pixels lie on one surface
SAME_SURFACE = 0.04


def upsample_depth(
    inverse: Float[np.ndarray, "height width"],
    confidence: Float[np.ndarray, "height width"] | Bool[np.ndarray, "height width"],
    guide: Float[np.ndarray, "height width 3"],
    image: Float[np.ndarray, "height2 width2 3"],
) -> tuple[Float[np.ndarray, "height2 width2"], Float[np.ndarray, "height2 width2"]]:
    """Inverse depth and confidence of the small image `guide` for every pixel of the large `image`.

    Each pixel joins the surface of the nearby small pixel that looks most like it, so depth edges
    stay sharp: depths are interpolated within a surface, never across two. Joint bilateral
    upsampling (Kopf et al. 2007) over the four nearest small pixels. Colours in [0, 1]. Not
    differentiable.
    """
    if guide.shape == image.shape:
        return inverse, confidence.astype(np.float32)
    return _joint_upsample(
        inverse,
        confidence.astype(np.float32),
        guide,
        np.ascontiguousarray(image, np.float32),
    )


@compiled(nogil=True)
def _joint_upsample(inverse, measured, guide, photo):  # pragma: no cover - compiled
    small_height, small_width = inverse.shape
    height, width = photo.shape[:2]
    result = np.empty((height, width), np.float32)
    trust = np.empty((height, width), np.float32)
    weights = np.empty(4, np.float32)
    depths = np.empty(4, np.float32)
    trusts = np.empty(4, np.float32)
    for y in range(height):
        place_y = min(
            max((y + 0.5) * small_height / height - 0.5, 0.0), small_height - 1.0
        )
        top = min(int(place_y), max(small_height - 2, 0))
        for x in range(width):
            place_x = min(
                max((x + 0.5) * small_width / width - 0.5, 0.0), small_width - 1.0
            )
            left = min(int(place_x), max(small_width - 2, 0))
            best = 0
            for corner in range(4):
                v = min(top + corner // 2, small_height - 1)
                u = min(left + corner % 2, small_width - 1)
                distance = np.float32(0)
                for channel in range(3):
                    distance += (photo[y, x, channel] - guide[v, u, channel]) ** 2
                near = max(1 - abs(place_y - v), 0.0) * max(1 - abs(place_x - u), 0.0)
                # none alike: then all the same
                likeness = max(np.exp(-distance / SAME_COLOUR**2), 1e-5)
                weights[corner] = (near + 1e-3) * likeness
                depths[corner], trusts[corner] = inverse[v, u], measured[v, u]
                if weights[corner] > weights[best]:
                    best = corner
            total, depth, certain = 1e-12, 0.0, 0.0
            for corner in range(4):
                if abs(depths[corner] - depths[best]) <= SAME_SURFACE * depths[best]:
                    total += weights[corner]
                    depth += weights[corner] * depths[corner]
                    certain += weights[corner] * trusts[corner]
            result[y, x] = depth / total
            trust[y, x] = certain / total
    return result, trust
