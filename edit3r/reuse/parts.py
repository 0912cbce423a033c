"""Matchers and segmenters that remember their answers, in place of the parts a component was declared with."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any

import torch
from torch import Tensor

from edit3r.interfaces import MatchedGeometry, Matcher, Proposal, Reconstructor, Segmenter, Tracks
from edit3r.reuse.fingerprint import fingerprint, identity
from edit3r.reuse.memory import Memory
from edit3r.types import Cameras, Gaussians, Reconstruction, Views


def remembering(memory: Memory) -> Callable[[Any], Any]:
    """Turns a part into one that remembers; parts of other kinds stay as they are."""

    def turned(part: Any) -> Any:
        if isinstance(part, Matcher):
            return RememberingMatcher(part, memory)
        return RememberingSegmenter(part, memory) if isinstance(part, Segmenter) else part

    return turned


class _Remembering:
    """Stands for `remembers` in everything but its answers, which come from memory where they are known."""

    def __init__(self, remembers: Any, memory: Memory) -> None:
        self.remembers, self._memory = remembers, memory
        for name in ("settings", "offer", "parts"):
            if hasattr(remembers, name):
                setattr(self, name, getattr(remembers, name))

    def __getattr__(self, name: str) -> Any:
        if name == "remembers":  # while it is being copied or unpickled
            raise AttributeError(name)
        return getattr(self.remembers, name)

    def _key(self, *question: Any) -> str:
        return fingerprint(identity(self.remembers), *question)


class RememberingMatcher(_Remembering, Matcher):
    def match(self, views: Views) -> MatchedGeometry:
        return self._memory.recall(
            "match",
            self._key("match", views),
            lambda: self.remembers.match(views),
            lambda geometry: ({name: value for name, value in vars(geometry).items() if value is not None}, {}),
            lambda tensors, _: MatchedGeometry(**_on(views.images, tensors)),
        )


class RememberingSegmenter(_Remembering, Segmenter):
    def propose(self, image: Tensor) -> tuple[Proposal, ...]:
        return self._proposals("propose", image, (), lambda: self.remembers.propose(image))

    def segment(
        self,
        image: Tensor,
        points: Sequence[tuple[float, float]] = (),
        box: tuple[float, float, float, float] | None = None,
    ) -> Proposal:
        question = ([list(point) for point in points], box)
        (answer,) = self._proposals("segment", image, question, lambda: (self.remembers.segment(image, points, box),))
        return answer

    def segment_text(self, image: Tensor, text: str) -> tuple[Proposal, ...] | None:
        return self._proposals("segment_text", image, (text,), lambda: self.remembers.segment_text(image, text))

    def track(self, images: Tensor, masks: Tensor) -> Tracks:
        return self._memory.recall(
            "track",
            self._key("track", images, masks),
            lambda: self.remembers.track(images, masks),
            lambda tracks: (_tensors(tracks), {}),
            lambda tensors, _: Tracks(**_on(images, tensors)),
        )

    def _proposals(self, stage: str, image: Tensor, question: tuple, compute: Callable) -> tuple[Proposal, ...] | None:
        return self._memory.recall(
            stage,
            self._key(stage, image, question),
            compute,
            _pack_proposals,
            lambda tensors, facts: _unpack_proposals(_on(image, tensors), facts),
        )


def remembered_reconstruction(
    memory: Memory, reconstructor: Reconstructor, views: Views, compute: Callable[[], Reconstruction]
) -> Reconstruction:
    """The reconstruction of unedited photos."""
    return memory.recall(
        "reconstruct",
        fingerprint(identity(reconstructor), "reconstruct", views),
        compute,
        pack_reconstruction,
        lambda tensors, facts: unpack_reconstruction(_on(views.images, tensors), facts),
    )


def pack_reconstruction(reconstruction: Reconstruction) -> tuple[dict[str, Tensor], dict]:
    tensors, cameras, facts = dict(vars(reconstruction.gaussians)), reconstruction.cameras, {}
    if cameras is not None:
        tensors |= {"c2w": cameras.c2w, "intrinsics": cameras.intrinsics}
        facts["image_size"] = list(cameras.image_size)
    return tensors, facts


def unpack_reconstruction(tensors: dict[str, Tensor], facts: dict) -> Reconstruction:
    rest = dict(tensors)
    cameras = None
    if "image_size" in facts:
        cameras = Cameras(rest.pop("c2w"), rest.pop("intrinsics"), tuple(facts["image_size"]))
    return Reconstruction(Gaussians(**rest), cameras)


def _pack_proposals(proposals: tuple[Proposal, ...] | None) -> tuple[dict[str, Tensor], dict]:
    if proposals is None:
        return {}, {"read": False}
    masks = {f"mask_{index:03d}": proposal.soft_mask for index, proposal in enumerate(proposals)}
    numbers = [asdict(replace(p, soft_mask=torch.empty(0))) | {"soft_mask": None} for p in proposals]
    return masks, {"read": True, "proposals": numbers}


def _unpack_proposals(masks: dict[str, Tensor], facts: dict) -> tuple[Proposal, ...] | None:
    if not facts["read"]:
        return None
    return tuple(
        Proposal(**{**numbers, "soft_mask": mask, "box": tuple(numbers["box"])})
        for (_, mask), numbers in zip(sorted(masks.items()), facts["proposals"])
    )


def _tensors(answer: Any) -> dict[str, Tensor]:
    """The fields of a dataclass of tensors that are there."""
    return {name: value for name, value in vars(answer).items() if value is not None}


def _on(like: Tensor, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name: tensor.to(like.device) for name, tensor in tensors.items()}
