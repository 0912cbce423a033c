"""Learned features and their matches, by kornia or transformers; nothing here downloads anything.

They find motions between wide views that SIFT misses; where both work SIFT's points are the more
exact ones.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from edit3r.contract.errors import InputError
from edit3r.kit.weights.load import ChosenWeights, foreign, load_whole_network
from edit3r_matching.features import Keypoints

__all__ = ["LearnedFeatures", "PairNetwork", "load"]

Between = tuple[dict[int, Keypoints], dict[tuple[int, int], Int[np.ndarray, "match 2"]]]
"""Features of each view, and the indices of those that match of each pair of views."""

_PREFIX = "matcher."
_CLASSES = {
    "efficientloftr": "EfficientLoFTRForKeypointMatching",
    "superpoint-lightglue": "LightGlueForKeypointMatching",
}
_STRIDE = (
    32  # [pixels] sides that every one of these networks takes are multiples of it
)


def load(name: str, folder: Path, limit: int) -> "LearnedFeatures | PairNetwork":
    """The networks whose weights, called `name`, lie in `folder`; for about `limit` features an
    image.
    """
    return (
        PairNetwork.load(name, folder, limit)
        if name in _CLASSES
        else LearnedFeatures.load(folder, limit)
    )


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
        # No name of features: with one, kornia would download weights.
        matcher = LightGlue(None, input_dim=128, weights=None)
        _load(detector, folder / "aliked-n16.pth", {})
        layers = range(len(matcher.transformers))
        pairs = [(layer, kind) for layer in layers for kind in ("self", "cross")]
        renamed = {
            f"{kind}_attn.{layer}.": f"transformers.{layer}.{kind}_attn."
            for layer, kind in pairs
        }
        _load(matcher, folder / "aliked_lightglue.pth", renamed)
        return LearnedFeatures(detector.eval(), matcher.eval())

    def between(
        self,
        images: Mapping[int, Float[np.ndarray, "height width 3"]],
        pairs: Sequence[tuple[int, int]],
        size: int,
    ) -> Between:
        """Features of `images` in [0, 1], looked for at a long side of `size` [pixels], and the
        matches of `pairs`.
        """
        found = {view: self.detect(image, size) for view, image in images.items()}
        sizes = {view: image.shape[:2] for view, image in images.items()}
        return found, {
            (a, b): self.match(found[a], found[b], (sizes[a], sizes[b]))
            for a, b in pairs
        }

    def detect(
        self, image: Float[np.ndarray, "height width 3"], detection_size: int
    ) -> Keypoints:
        """The features of `image` in [0, 1], looked for at a long side of `detection_size`
        [pixels].
        """
        height, width = image.shape[:2]
        scale = detection_size / max(height, width)
        size = (max(32, round(width * scale)), max(32, round(height * scale)))
        resized = cv2.resize(
            image, size, interpolation=cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
        )
        with _one_thread(), torch.inference_mode():
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
        with _one_thread(), torch.inference_mode():
            asked = {
                f"image{i}": _as_asked(*side)
                for i, side in enumerate(zip((a, b), sizes))
            }
            return self.matcher(asked)["matches"][0].numpy()


@dataclass(frozen=True)
class PairNetwork:
    """EfficientLoFTR (Wang et al. 2024), or SuperPoint (DeTone et al. 2018) with LightGlue, by
    transformers.
    """

    network: nn.Module
    limit: int  # most matches of a pair
    semi_dense: bool  # EfficientLoFTR: its keypoints come in pairs

    @staticmethod
    def load(name: str, folder: Path, limit: int) -> "PairNetwork":
        """Raises MissingDependencyError without transformers, InputError for files that are
        something else.
        """
        weights = ChosenWeights(
            str(folder), "reconstructor.matcher.matches", local_files_only=True
        )
        network = load_whole_network(
            foreign("transformers", _CLASSES[name]), weights, dtype=torch.float32
        ).eval()
        semi_dense = name == "efficientloftr"
        if semi_dense:
            network._get_matches_from_scores = partial(_paired, network.config)
        else:
            network.keypoint_detector.keypoint_decoder.max_keypoints = limit
        return PairNetwork(network, limit, semi_dense)

    def between(
        self,
        images: Mapping[int, Float[np.ndarray, "height width 3"]],
        pairs: Sequence[tuple[int, int]],
        size: int,
    ) -> Between:
        """As `LearnedFeatures.between`; what several pairs see within one pixel is one feature."""
        grey = {view: _grey(image, size) for view, image in images.items()}
        found = {pair: self._match(grey[pair[0]], grey[pair[1]]) for pair in pairs}
        points: dict[int, Float[np.ndarray, "feature 2"]] = {}
        indices = {pair: np.zeros((len(own), 2), int) for pair, own in found.items()}
        for view, image in images.items():
            parts = [(pair, pair.index(view)) for pair in pairs if view in pair]
            every = np.concatenate([found[pair][:, side] for pair, side in parts])
            _, first, which = np.unique(
                np.round(every), axis=0, return_index=True, return_inverse=True
            )
            for (pair, side), own in zip(
                parts,
                np.split(which.ravel(), np.cumsum([len(found[p]) for p, _ in parts])),
            ):
                indices[pair][:, side] = own
            points[view] = (
                (every[first] + 0.5)
                * np.array(image.shape[1::-1])
                / np.array(grey[view].shape[::-1])
            )
        none = {
            view: np.zeros((len(own), 128), np.float32) for view, own in points.items()
        }
        return {
            view: Keypoints(own, none[view]) for view, own in points.items()
        }, indices

    def _match(
        self, *pair: Float[np.ndarray, "height width"]
    ) -> Float[np.ndarray, "match 2 2"]:
        """Matches of two images of one size, the best first: x, y in each [pixels, whole ones at
        pixel centres].
        """
        with _one_thread(), torch.inference_mode():
            pixels = torch.from_numpy(np.stack(pair))[None, :, None].expand(
                -1, -1, 3, -1, -1
            )
            told = self.network(pixel_values=pixels)
        partners, keypoints = told.matches[0, 0].long(), told.keypoints[0].double()
        matched = (
            partners >= 0
            if self.semi_dense
            else (partners >= 0) & told.mask[0, 0].bool()
        )
        other = keypoints[1] if self.semi_dense else keypoints[1][partners]
        order = told.matching_scores[0, 0][matched].argsort(
            descending=True, stable=True
        )[: self.limit]
        relative = torch.stack((keypoints[0][matched], other[matched]), dim=1)[
            order
        ].numpy()
        return relative * np.array(pair[0].shape[::-1])


def _paired(
    config: Any, scores: Float[Tensor, "1 h0 w0 h1 w1"]
) -> tuple[Tensor, Tensor]:
    """Cells of image 0 with their mutual best ones in image 1, both -1 where there is none, and the
    scores.

    transformers 5.23 lists image 0's cells by those of image 1 and image 1's by those of image 0,
    so that the fine matching compares windows that have nothing in common.
    """
    border, (height, width) = config.coarse_matching_border_removal, scores.shape[-2:]
    inside = torch.zeros(height, width, dtype=torch.bool)
    inside[border : height - border, border : width - border] = True
    flat = scores.flatten(1, 2).flatten(2)[0]
    best, partner = flat.max(1)
    mutual = (flat.argmax(0)[partner] == torch.arange(len(flat))) & (
        best > config.coarse_matching_threshold
    )
    kept = mutual & inside.flatten() & inside.flatten()[partner]
    pairs = torch.stack((torch.arange(len(flat)), partner)).where(kept, -1)
    return pairs[None], (best * kept).expand(1, 2, -1)


def _grey(
    image: Float[np.ndarray, "height width 3"], size: int
) -> Float[np.ndarray, "h w"]:
    """The image in [0, 1] in shades of grey, its long side about `size` [pixels]."""
    scale = size / max(image.shape[:2])
    height, width = (
        max(1, round(side * scale / _STRIDE)) * _STRIDE for side in image.shape[:2]
    )
    grey = cv2.cvtColor(np.clip(image, 0, 1).astype(np.float32), cv2.COLOR_RGB2GRAY)
    return cv2.resize(
        grey,
        (width, height),
        interpolation=cv2.INTER_LINEAR if scale > 1 else cv2.INTER_AREA,
    )


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


@contextmanager
def _one_thread() -> Iterator[None]:
    """Compute with one thread: with another number of them sums, and so the choice of a match,
    could differ.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
