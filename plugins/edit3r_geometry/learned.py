"""Learned features and their matches, by kornia; nothing here downloads anything.

They find motions between wide views that SIFT misses; where both work SIFT's points are the more
exact ones.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from edit3r.contract.errors import InputError
from edit3r.kit.compute.layers import one_thread
from edit3r_geometry.keypoints import Keypoints

_PREFIX = "matcher."


@dataclass(frozen=True)
class LearnedFeatures:
    """ALIKED (Zhao et al. 2023) with LightGlue (Lindenberger et al. 2023), by kornia."""

    detector: nn.Module
    matcher: nn.Module

    @staticmethod
    def load(folder: Path, limit: int) -> "LearnedFeatures":
        """Networks with the weights in `folder`, for at most `limit` features an image.

        Raises InputError for files that are something else.
        """
        from kornia.feature import ALIKED, LightGlue

        detector = ALIKED("aliked-n16", max_num_keypoints=limit)
        # No name of features, which may be None: with one, kornia would download weights.
        matcher = LightGlue(None, input_dim=128, weights=None)  # type: ignore[arg-type]
        _load(detector, folder / "aliked-n16.pth", {})
        layers = range(len(matcher.transformers))
        pairs = [(layer, kind) for layer in layers for kind in ("self", "cross")]
        renamed = {
            f"{kind}_attn.{layer}.": f"transformers.{layer}.{kind}_attn."
            for layer, kind in pairs
        }
        _load(matcher, folder / "aliked_lightglue.pth", renamed)
        return LearnedFeatures(detector.eval(), matcher.eval())

    def detect(
        self, image: Float[np.ndarray, "height width 3"], detection_size: int
    ) -> Keypoints:
        """Features of `image` in [0, 1], found at a long side of `detection_size` [pixels]."""
        height, width = image.shape[:2]
        scale = detection_size / max(height, width)
        size = (max(32, round(width * scale)), max(32, round(height * scale)))
        resized = cv2.resize(
            image, size, interpolation=cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
        )
        with one_thread(), torch.inference_mode():
            pixels = (
                torch.from_numpy(np.clip(resized, 0, 1))
                .permute(2, 0, 1)[None]
                .contiguous()
            )
            found = self.detector(pixels)[0]
        points = (
            (found.keypoints.double().numpy() + 0.5)
            * np.array([width, height])
            / np.array(size)
        )
        return Keypoints(points, found.descriptors.float().numpy())

    def match(
        self, a: Keypoints, b: Keypoints, sizes: tuple[tuple[int, int], tuple[int, int]]
    ) -> Int[np.ndarray, "match 2"]:
        """Pairs of indices of the features of two images whose (height, width) are `sizes`."""
        if min(len(a), len(b)) < 2:
            return np.zeros((0, 2), int)
        with one_thread(), torch.inference_mode():
            asked = {
                f"image{i}": _as_asked(*side)
                for i, side in enumerate(zip((a, b), sizes))
            }
            return self.matcher(asked)["matches"][0].numpy()


def _as_asked(keypoints: Keypoints, size: tuple[int, int]) -> dict[str, Tensor]:
    """One image's features in LightGlue's form, which takes no place outside the image."""
    width_height = torch.tensor([size[::-1]]).float()
    places = torch.from_numpy(keypoints.points - 0.5).float()[None]
    return {
        "keypoints": places.clamp(min=torch.zeros(2), max=width_height),
        "descriptors": torch.from_numpy(keypoints.descriptors)[None],
        "image_size": width_height,
    }


def _load(network: nn.Module, file: Path, renamed: Mapping[str, str]) -> None:
    """Read weights into `network`; every parameter must be there, and none may be left over."""
    try:
        state = torch.load(file, map_location="cpu", weights_only=True)
        for old, new in renamed.items():
            state = {
                name.removeprefix(_PREFIX).replace(old, new): value
                for name, value in state.items()
            }
        missing, left = network.load_state_dict(state, strict=False)
    except Exception as error:  # torch raises many kinds for what is no file of weights
        raise InputError(
            f"{file}: cannot be read as weights ({error}); fetch them again."
        ) from None
    lacking = [name for name in missing if name in dict(network.named_parameters())]
    if lacking or left:
        raise InputError(
            f"{file}: not the weights expected ({', '.join((*lacking, *left)[:3])}); fetch them "
            "again."
        )
