"""Contracts of what training needs: dataset, loss and trainer."""

import pickle
import tempfile
from dataclasses import fields, replace
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r.config import Settings
from edit3r.contract.interfaces import (
    Dataset,
    Loss,
    LossInputs,
    Reconstructor,
    SceneSample,
    Trainer,
    TrainingJob,
)
from edit3r.contract.types import Cameras, Reconstruction, Views
from edit3r.geometry.cameras import pixels_to_gaussians
from edit3r_testing.contract import GAUSSIAN_FIELDS, Contract
from edit3r_testing.rasterizer import reference_rasterizer
from edit3r_testing.scenes import gaussian_cloud, photograph


class DatasetContract(Contract):
    """Shapes and ranges as promised; the same index gives the same sample; picklable for
    workers.
    """

    kind = "dataset"
    subject: Dataset

    def sample(self, index: int = 0, subject: Dataset | None = None) -> SceneSample:
        sample = self.call(
            f"dataset[{index}]", (subject or self.subject).__getitem__, index
        )
        self.require_type(f"dataset[{index}] is", sample, SceneSample, "a SceneSample")
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
        for name in (
            "context",
            "target",
            "edited_context",
            "edited_target",
            "context_masks",
            "target_masks",
        ):
            tensor = getattr(sample, name)
            if tensor is not None:
                self.require_range(
                    f"sample.{name}", tensor, 0, 1, "divide 8-bit pictures by 255"
                )
        self._check_masks(sample, (views, targets), (height, width))

    def test_cameras_are_in_the_frame_of_view_0(self) -> None:
        sample = self.sample()
        for name in ("context", "target"):
            cameras, images = getattr(sample, f"{name}_cameras"), getattr(sample, name)
            self.require_type(f"{name}_cameras is", cameras, Cameras, "Cameras")
            self.require_tensor(
                f"{name}_cameras.c2w", cameras.c2w, (1, images.shape[0], 4, 4)
            )
            size = tuple(images.shape[-2:])
            self.require(
                tuple(cameras.image_size) == size,
                f"{name}_cameras.image_size is {cameras.image_size}, pictures are {size}.",
            )
            focal = cameras.intrinsics[..., 0, 0].max().item()
            self.require(
                focal < 20,
                f"a focal length of {focal:.4g} image widths; intrinsics are normalised, not "
                "pixels.",
            )
        fix = "multiply every pose by the inverse of context view 0's (geometry.cameras.relative_to_first)"
        self.require_equal(
            "context view 0 is not at the origin",
            sample.context_cameras.c2w[0, 0],
            torch.eye(4),
            fix,
            1e-4,
        )

    def test_the_same_index_gives_the_same_sample(self) -> None:
        last = len(self.subject) - 1
        first = self.sample(0)
        self.sample(last)
        torch.rand(3)
        fix = "derive every random choice from the seed in the settings and the index"
        self._require_same(
            self.sample(0), first, "index 0 asked twice gave two samples", fix
        )
        self._require_same(
            self.sample(0, self.build()),
            first,
            "a fresh dataset gave another sample 0",
            fix,
        )

    def test_survives_pickling(self) -> None:
        copy = self.call("pickling", lambda: pickle.loads(pickle.dumps(self.subject)))
        fix = "open files in __getitem__, hold only paths and numbers"
        self._require_same(
            self.sample(0, copy),
            self.sample(0),
            "a pickled copy gave another sample 0",
            fix,
        )

    def test_an_index_beyond_the_end_is_an_index_error(self) -> None:
        """Plain iteration, `for sample in dataset`, ends by it."""
        try:
            self.subject[len(self.subject)]
        except IndexError:
            return
        except Exception as error:
            self.require(
                False,
                f"dataset[len(dataset)] raised {type(error).__name__}; raise IndexError.",
            )
        self.require(
            False,
            "dataset[len(dataset)] gave a sample; raise IndexError, iteration would never end.",
        )

    def _check_masks(
        self, sample: SceneSample, views: tuple[int, int], size: tuple[int, int]
    ) -> None:
        """Object masks of context and target follow the same objects."""
        given = (sample.context_masks, sample.target_masks)
        counts = {mask.shape[0] for mask in given if mask is not None}
        self.require(
            len(counts) < 2,
            f"context and target masks follow {sorted(counts)} objects; follow the same ones.",
        )
        for name, mask, count in zip(("context_masks", "target_masks"), given, views):
            if mask is not None:
                self.require_tensor(
                    f"sample.{name}", mask, (mask.shape[0], count, *size)
                )

    def _require_same(
        self, sample: SceneSample, expected: SceneSample, what: str, fix: str
    ) -> None:
        for field in fields(SceneSample):
            a, b = getattr(sample, field.name), getattr(expected, field.name)
            if isinstance(b, Tensor):
                self.require_equal(f"{what} ({field.name})", a, b, fix)


class LossContract(Contract):
    """A finite scalar, zero at the target, positive away from it, with finite gradients at both."""

    kind = "loss"
    subject: Loss
    image_size: tuple[int, int] = (48, 64)  # (height, width) [pixels]
    zero: float = 1e-5  # what counts as zero at the target

    def test_zero_at_the_target(self) -> None:
        value = self._value(self._inputs(distance=0)).item()
        self.require(
            abs(value) <= self.zero,
            f"at the target it is {value:.4g}; subtract its minimum, it must be 0.",
        )

    def test_positive_away_from_the_target(self) -> None:
        value = self._value(self._inputs(distance=0.2)).item()
        self.require(
            value > self.zero,
            f"away from the target it is {value:.4g}; it must grow with the difference.",
        )

    def test_gradients_are_finite(self) -> None:
        for distance, place in ((0.2, "away from the target"), (0.0, "at the target")):
            inputs, leaves = _with_gradients(self._inputs(distance))
            value = self._value(inputs)
            self.require(
                value.requires_grad,
                "it carries no gradient; compute it from inputs.rendered or .gaussians.",
            )
            gradients = [
                g
                for g in torch.autograd.grad(value, leaves, allow_unused=True)
                if g is not None
            ]
            finite = all(bool(torch.isfinite(gradient).all()) for gradient in gradients)
            self.require(
                finite,
                f"its gradient {place} is not finite; use a smooth norm, sqrt(x) has none at 0.",
            )
            moves = any(gradient.abs().max() > 0 for gradient in gradients)
            self.require(
                distance == 0 or moves,
                f"its gradient {place} is zero; it would teach nothing.",
            )

    def test_leaves_its_inputs_alone(self) -> None:
        inputs = self._inputs(distance=0.2)
        before = inputs.rendered.clone()
        self._value(inputs)
        self.require_equal(
            "it changed inputs.rendered",
            inputs.rendered,
            before,
            "do not use in-place operations",
        )

    def _value(self, inputs: LossInputs) -> Float[Tensor, ""]:
        value = self.call("the loss", self.subject, inputs)
        self.require_tensor("the loss", value, ())
        return value

    def _inputs(self, distance: float) -> LossInputs:
        """Images and Gaussians that lie `distance` from their targets."""
        target = photograph(2, self.image_size, batch=2).views.images.to(self.device)
        count = target.shape[1] * 24
        cloud = gaussian_cloud(count, batch=2)  # of two views in turn, half each
        reference = replace(
            cloud, view_index=torch.arange(2).repeat_interleave(count // 2)
        ).to(self.device)
        generator = torch.Generator().manual_seed(5)
        noise = torch.rand(target.shape, generator=generator).to(self.device)
        shift = torch.randn(reference.means.shape, generator=generator).to(self.device)
        return LossInputs(
            rendered=(1 - distance) * target + distance * noise,
            target=target,
            gaussians=replace(
                reference,
                means=reference.means + distance * shift,
                scales=reference.scales * (1 + distance),
            ),
            reference=reference,
        )


def _with_gradients(inputs: LossInputs) -> tuple[LossInputs, list[Tensor]]:
    """The same inputs with the prediction's tensors as leaves."""
    rendered = inputs.rendered.clone().requires_grad_()
    leaves = {
        name: getattr(inputs.gaussians, name).clone().requires_grad_()
        for name in GAUSSIAN_FIELDS
    }
    gaussians = replace(inputs.gaussians, **leaves)
    return replace(inputs, rendered=rendered, gaussians=gaussians), [
        rendered,
        *leaves.values(),
    ]


class TrainerContract(Contract):
    """Trains a tiny network for the steps its settings say, and leaves a folder with a checkpoint.

    Set `settings` to a recipe of a few steps; the reconstructor, data and loss are made by formula.
    """

    kind = "trainer"
    subject: Trainer

    def test_trains_and_returns_the_folder_of_a_checkpoint(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            job = tiny_job(Path(folder))
            before = job.reconstructor.network.weight.detach().clone()
            best = self.call("train()", self.subject.train, job)
            self.require_type("train() returned", best, Path, "the folder's Path")
            inside = best.is_dir() and Path(folder).resolve() in (
                best.resolve(),
                *best.resolve().parents,
            )
            self.require(
                inside,
                f"train() returned {best}, which is no folder in job.out; write nothing elsewhere.",
            )
            self.require(
                any(best.iterdir()), f"{best.name}/ is empty; save a checkpoint there."
            )
            after = job.reconstructor.network.weight.detach()
            self.require(
                not torch.equal(before, after),
                "no weight moved; step the optimiser of reconstructor.network.",
            )

    def test_resumes(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            self.call("train()", self.subject.train, tiny_job(Path(folder)))
            again = self.call(
                "train() with resume=True",
                self.subject.train,
                replace(tiny_job(Path(folder)), resume=True),
            )
            self.require(
                again.is_dir(),
                f"a resumed training returned {again}, which is no folder.",
            )


class _PixelReconstructor(Reconstructor):
    """One Gaussian per pixel at a fixed depth, its colour from a learned 1x1 convolution."""

    settings = Settings()

    def __init__(self) -> None:
        self._network = nn.Conv2d(3, 3, 1)
        with torch.no_grad():
            self._network.weight.copy_(0.5 * torch.eye(3)[..., None, None])
            self._network.bias.zero_()

    @property
    def network(self) -> nn.Module:
        return self._network

    def __call__(
        self,
        views: Views,
        source: Views | None = None,
        grid: tuple[int, int] | None = None,
    ) -> Reconstruction:
        batch, count, _, height, width = views.images.shape
        colours = self._network(views.images.flatten(0, 1)).unflatten(0, (batch, count))
        cameras = Cameras(
            torch.eye(4).expand(batch, count, 4, 4), views.intrinsics, views.image_size
        )
        depths = torch.full((batch, count, height, width), 3.0)
        scales, opacities = (
            torch.full_like(depths, 3.0 / width),
            torch.full_like(depths, 0.6),
        )
        return Reconstruction(
            pixels_to_gaussians(colours, depths, cameras, scales, opacities), cameras
        )


class _FormulaScenes(Dataset):
    """Four scenes of `photograph`: two context views and one target view between them."""

    settings = Settings()

    def __len__(self) -> int:
        return 4

    def __getitem__(self, index: int) -> SceneSample:
        if not 0 <= index < len(self):
            raise IndexError(index)
        scene = photograph(3, (16, 24), seed=index)
        context, target = [0, 2], [1]
        return SceneSample(
            context=scene.views.images[0, context],
            target=scene.views.images[0, target],
            context_cameras=scene.cameras.select(context),
            target_cameras=scene.cameras.select(target),
            context_depths=scene.depths[0, context],
            context_masks=scene.objects[:, 0][:, context],
            target_masks=scene.objects[:, 0][:, target],
            name=f"formula-{index}",
        )


class _MeanSquares(Loss):
    settings = Settings()

    def __call__(self, inputs: LossInputs) -> Float[Tensor, ""]:
        return F.mse_loss(inputs.rendered, inputs.target)


def tiny_job(out: Path) -> TrainingJob:
    """A training that takes seconds: a network of one layer, four scenes by formula, one loss."""
    losses = {"mean-squares": (1.0, _MeanSquares())}
    return TrainingJob(
        _PixelReconstructor(),
        reference_rasterizer(),
        _FormulaScenes(),
        _FormulaScenes(),
        losses,
        out,
    )
