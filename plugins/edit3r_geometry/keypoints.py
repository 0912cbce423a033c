"""Features of one image."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Keypoints:
    """Where the features are and what they look like."""

    # x, y [pixels of the image, pixel centres at +0.5], float64
    points: Float[np.ndarray, "point 2"]
    descriptors: Float[np.ndarray, "point 128"]  # unit length, float32

    def __len__(self) -> int:
        return len(self.points)

    def followed_by(self, more: "Keypoints") -> "Keypoints":
        """These features, then `more` of the same image."""
        return Keypoints(
            *map(
                np.concatenate,
                ((self.points, more.points), (self.descriptors, more.descriptors)),
            )
        )
