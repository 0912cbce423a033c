"""Losses, datasets and trainers."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxtyping import Float
from torch import Tensor
from torch.utils import data

from edit3r.contract.component import Configured
from edit3r.contract.interfaces.reconstruction import Geometry, Matcher, Reconstructor
from edit3r.contract.interfaces.rendering import Rasterizer
from edit3r.contract.types import Cameras, Gaussians, Rendering


@dataclass(frozen=True)
class LossInputs:
    """All that a loss may compare. What a training step does not have is None."""

    # of the prediction
    rendered: Float[Tensor, "batch view 3 height width"] | None = None
    # what they should show
    target: Float[Tensor, "batch view 3 height width"] | None = None
    gaussians: Gaussians | None = None  # the prediction
    # the frozen reconstructor's answer for the unedited photos, Gaussian by Gaussian
    reference: Gaussians | None = None
    cameras: Cameras | None = None  # of `rendered`, in the frame of `gaussians`
    # true camera z that `cameras` see, 0 where nobody knows it
    depths: Float[Tensor, "batch view height width"] | None = None
    # what `rendered` shows from any cameras, all that the rasterizer gives, differentiable; from
    # `cameras` themselves nothing is drawn again
    render: Callable[[Cameras], Rendering] | None = None
    # poses and depths of the input views, as a matcher reads them, in the unit of `cameras`
    geometry: Geometry | None = None


class Loss(Configured, ABC):
    """One term of a training objective; its weight is applied by the trainer."""

    @abstractmethod
    def __call__(self, inputs: LossInputs) -> Float[Tensor, ""]:
        """A finite scalar, least at the target; a rule of the scene alone compares with none."""


@dataclass(frozen=True)
class SceneSample:
    """One multi-view training sample, without a batch axis: V context and T target views."""

    context: Float[Tensor, "view 3 height width"]  # unedited
    target: Float[Tensor, "target 3 height width"]  # unedited
    context_cameras: Cameras  # batch 1; view 0 at the origin
    target_cameras: Cameras  # batch 1
    # camera z, 0 unknown
    context_depths: Float[Tensor, "view height width"] | None = None
    # instance masks
    context_masks: Float[Tensor, "object view height width"] | None = None
    target_masks: Float[Tensor, "object target height width"] | None = None
    # where the data knows the true edit
    edited_context: Float[Tensor, "view 3 height width"] | None = None
    edited_target: Float[Tensor, "target 3 height width"] | None = None
    name: str = ""


class Dataset(Configured, data.Dataset, ABC):
    """Multi-view samples by index.

    The same index and settings give the same sample, in any worker.
    """

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def __getitem__(self, index: int) -> SceneSample: ...

    def at_progress(self, index: int, progress: float) -> SceneSample:
        """The sample as a training at `progress` in [0, 1] should see it; by default the same.

        For data that begins easy and gets harder; `data[index]` is the sample at the end.
        """
        return self[index]


@dataclass(frozen=True)
class TrainingJob:
    """Everything a trainer is given, already built."""

    reconstructor: Reconstructor
    matcher: Matcher  # of photos whose geometry the data does not know
    rasterizer: Rasterizer
    train_data: Dataset
    validation_data: Dataset | None
    losses: Mapping[str, tuple[float, Loss]]  # name: (weight, loss)
    out: Path  # folder for checkpoints, logs and sample sheets
    resume: bool = False
    # the whole resolved one, saved with each checkpoint
    config: Mapping[str, Any] | None = None
    # frozen: its answer for the unedited photos is what 3D losses hold to
    reference: Reconstructor | None = None


class Trainer(Configured, ABC):
    """A way to train a reconstructor: what a step shows it, and what it is held to."""

    @abstractmethod
    def train(self, job: TrainingJob) -> Path:
        """Train until the recipe's last step; returns the folder of the best checkpoint."""
