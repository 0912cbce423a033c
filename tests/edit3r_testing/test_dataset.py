"""The dataset's contract finds every way of breaking it."""

from dataclasses import replace

import pytest
import torch

from edit3r.contract.interfaces import Dataset
from edit3r_testing import DatasetContract


class Spoiled(Dataset):
    """A good dataset whose samples are passed through `spoil`."""

    made = 0

    def __init__(self, good, spoil=None, count=None, bound=True, keep=None):
        self.good, self.spoil, self.count, self.bound, self.keep = (
            good,
            spoil,
            count,
            bound,
            keep,
        )
        Spoiled.made += 1
        self.number = Spoiled.made

    def __len__(self):
        return len(self.good) if self.count is None else self.count

    def __getitem__(self, index):
        sample = self.good[index if self.bound else index % len(self.good)]
        return self.spoil(self, sample) if self.spoil else sample


def dim(sample, factor):
    return replace(sample, context=sample.context * factor)


def in_pixels(me, sample):
    scaled = (
        sample.context_cameras.intrinsics * torch.tensor([64.0, 48.0, 1.0])[:, None]
    )
    return replace(
        sample, context_cameras=replace(sample.context_cameras, intrinsics=scaled)
    )


def in_the_world(me, sample):
    return replace(
        sample,
        context_cameras=replace(
            sample.context_cameras, c2w=sample.context_cameras.c2w + 1
        ),
    )


SHAPES, FRAME = "test_samples_are_valid", "test_samples_are_valid"
SAME, END = (
    "test_the_same_index_gives_the_same_sample",
    "test_an_index_beyond_the_end_is_an_index_error",
)
CASES = {
    "no samples": ({"count": 0}, "test_has_samples", "nothing could be trained on it"),
    "dictionaries": (
        {"spoil": lambda me, s: vars(s)},
        SHAPES,
        "interfaces.SceneSample, got dict",
    ),
    "8-bit values": (
        {"spoil": lambda me, s: dim(s, 255)},
        SHAPES,
        "return context in [0, 1]",
    ),
    "depths of another size": (
        {"spoil": lambda me, s: replace(s, context_depths=s.context_depths[..., ::2])},
        SHAPES,
        "of shape [2, 48, 64]",
    ),
    "masks of other objects": (
        {"spoil": lambda me, s: replace(s, target_masks=s.target_masks[:1])},
        SHAPES,
        "return target_masks of shape",
    ),
    "pixel intrinsics": ({"spoil": in_pixels}, FRAME, "normalise the focal lengths"),
    "world poses": ({"spoil": in_the_world}, FRAME, "in the frame of context view 0"),
    "random": (
        {"spoil": lambda me, s: dim(s, torch.rand(1))},
        SAME,
        "derive every random choice from the seed",
    ),
    "of another build": (
        {"spoil": lambda me, s: dim(s, 0.9 / me.number)},
        SAME,
        "a fresh dataset gave another",
    ),
    "an open file": (
        {"keep": (i for i in [])},
        "test_survives_pickling",
        "raised TypeError",
    ),
    "endless": ({"bound": False}, END, "iteration would never end"),
    "a key error": ({"spoil": None, "count": 7}, END, "raise IndexError"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_dataset_broken_by(case, examples, complaint):
    changes, claim, advice = CASES[case]
    good = examples.build("dataset", "worked-dataset")
    assert advice in complaint(DatasetContract, lambda: Spoiled(good, **changes), claim)


def test_every_claim_about_datasets_can_fail():
    own = {name for name in vars(DatasetContract) if name.startswith("test_")}
    assert own == {claim for _, claim, _ in CASES.values()}
