"""Contract of a dataset."""

import pickle
from dataclasses import fields

import torch
from torch import Tensor

from edit3r.interfaces import Dataset, SceneSample
from edit3r.testing.contract import Contract
from edit3r.types import Cameras


class DatasetContract(Contract):
    """Shapes and ranges as promised; the same index gives the same sample; picklable for workers."""

    kind = "dataset"
    subject: Dataset

    def sample(self, index: int = 0, subject: Dataset | None = None) -> SceneSample:
        sample = self.call(f"dataset[{index}]", (subject or self.subject).__getitem__, index)
        self.require(
            isinstance(sample, SceneSample), f"dataset[{index}] is a {type(sample).__name__}; return a SceneSample."
        )
        return sample

    def test_has_samples(self) -> None:
        count = self.call("len(dataset)", len, self.subject)
        self.require(count > 0, "len(dataset) is 0; nothing could be trained on it.")

    def test_shapes_and_ranges(self) -> None:
        sample = self.sample()
        height, width = sample.context.shape[-2:]
        views, targets = sample.context.shape[0], sample.target.shape[0]
        shapes = {
            "context": (views, 3, height, width),
            "target": (targets, 3, height, width),
            "context_depths": (views, height, width),
            "edited_context": (views, 3, height, width),
            "edited_target": (targets, 3, height, width),
        }
        for name, shape in shapes.items():
            tensor = getattr(sample, name)
            if tensor is not None:
                self.require_tensor(f"sample.{name}", tensor, shape)
        for name in ("context", "target", "edited_context", "edited_target", "context_masks", "target_masks"):
            tensor = getattr(sample, name)
            if tensor is not None:
                self.require_range(f"sample.{name}", tensor, 0, 1, "divide 8-bit pictures by 255")
        self._check_masks(sample, (views, targets), (height, width))

    def test_cameras_are_in_the_frame_of_view_0(self) -> None:
        sample = self.sample()
        for name in ("context", "target"):
            cameras, pictures = getattr(sample, f"{name}_cameras"), getattr(sample, name)
            self.require(isinstance(cameras, Cameras), f"{name}_cameras is a {type(cameras).__name__}; return Cameras.")
            self.require_tensor(f"{name}_cameras.c2w", cameras.c2w, (1, pictures.shape[0], 4, 4))
            size = tuple(pictures.shape[-2:])
            self.require(
                tuple(cameras.image_size) == size,
                f"{name}_cameras.image_size is {cameras.image_size}, pictures are {size}.",
            )
            focal = cameras.intrinsics[..., 0, 0].max().item()
            self.require(
                focal < 20, f"a focal length of {focal:.4g} image widths; intrinsics are normalised, not pixels."
            )
        fix = "multiply every pose by the inverse of context view 0's (geometry.cameras.relative_to_first)"
        self.require_equal(
            "context view 0 is not at the origin", sample.context_cameras.c2w[0, 0], torch.eye(4), fix, 1e-4
        )

    def test_the_same_index_gives_the_same_sample(self) -> None:
        last = len(self.subject) - 1
        first = self.sample(0)
        self.sample(last)
        torch.rand(3)
        fix = "derive every random choice from the seed in the settings and the index"
        self._require_same(self.sample(0), first, "index 0 asked twice gave two samples", fix)
        self._require_same(self.sample(0, self.build()), first, "a fresh dataset gave another sample 0", fix)

    def test_survives_pickling(self) -> None:
        copy = self.call("pickling", lambda: pickle.loads(pickle.dumps(self.subject)))
        fix = "open files in __getitem__, hold only paths and numbers"
        self._require_same(self.sample(0, copy), self.sample(0), "a pickled copy gave another sample 0", fix)

    def test_an_index_beyond_the_end_is_an_index_error(self) -> None:
        """Plain iteration, `for sample in dataset`, ends by it."""
        try:
            self.subject[len(self.subject)]
        except IndexError:
            return
        except Exception as error:
            self.require(False, f"dataset[len(dataset)] raised {type(error).__name__}; raise IndexError.")
        self.require(False, "dataset[len(dataset)] gave a sample; raise IndexError, iteration would never end.")

    def _check_masks(self, sample: SceneSample, views: tuple[int, int], size: tuple[int, int]) -> None:
        """Object masks of context and target follow the same objects."""
        given = (sample.context_masks, sample.target_masks)
        counts = {mask.shape[0] for mask in given if mask is not None}
        self.require(
            len(counts) < 2, f"context and target masks follow {sorted(counts)} objects; follow the same ones."
        )
        for name, mask, count in zip(("context_masks", "target_masks"), given, views):
            if mask is not None:
                self.require_tensor(f"sample.{name}", mask, (mask.shape[0], count, *size))

    def _require_same(self, sample: SceneSample, expected: SceneSample, what: str, fix: str) -> None:
        for field in fields(SceneSample):
            a, b = getattr(sample, field.name), getattr(expected, field.name)
            if isinstance(b, Tensor):
                self.require_equal(f"{what} ({field.name})", a, b, fix)
