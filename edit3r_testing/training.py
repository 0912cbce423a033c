"""Contracts of what training needs: dataset, loss and trainer."""

import pickle
import tempfile
from dataclasses import fields, replace
from functools import cached_property, partial
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r.contract.interfaces import (
    Dataset,
    Geometry,
    Loss,
    LossInputs,
    Matcher,
    Rasterizer,
    Reconstructor,
    SceneSample,
    Trainer,
    TrainingJob,
)
from edit3r.contract.settings import Settings
from edit3r.contract.types import PER_GAUSSIAN, Cameras, Reconstruction, Views
from edit3r.kit import asking
from edit3r.kit.geometry.cameras import pixels_to_gaussians
from edit3r_testing.contract import Contract
from edit3r_testing.rasterizer import reference_rasterizer
from edit3r_testing.scenes import (
    cameras_around,
    gaussian_cloud,
    photograph,
    true_geometry,
)


class DatasetContract(Contract):
    """Shapes and ranges as promised; the same index gives the same sample, in any worker."""

    kind = "dataset"
    subject: Dataset

    def sample(self, index: int = 0, subject: Dataset | None = None) -> SceneSample:
        asked = subject or self.subject
        return self.ask(asking.sample, lambda: asked[index], subject=asked)

    def test_has_samples(self) -> None:
        count = self.call(len, self.subject)
        self.require(count > 0, "len(dataset) is 0; nothing could be trained on it.")

    def test_samples_are_valid(self) -> None:
        """Shapes, ranges, and cameras in the frame of context view 0."""
        self.sample()
        self.sample(len(self.subject) - 1)

    def test_the_same_index_gives_the_same_sample(self) -> None:
        first = self.sample()
        self.sample(len(self.subject) - 1)
        torch.rand(3)
        fix = "derive every random choice from the seed in the settings and the index"
        self._require_same(self.sample(), first, "index 0 asked twice", fix)
        fresh = self.sample(0, self.build())
        self._require_same(fresh, first, "index 0 of a fresh dataset", fix)

    def test_survives_pickling(self) -> None:
        copy = self.call(lambda: pickle.loads(pickle.dumps(self.subject)))
        fix = "open files in __getitem__, hold only paths and numbers"
        again = self.sample(0, copy)
        self._require_same(again, self.sample(), "index 0 of a pickled copy", fix)

    def test_an_index_beyond_the_end_is_an_index_error(self) -> None:
        """Plain iteration, `for sample in dataset`, ends by it."""
        end = len(self.subject)
        found = "a sample"
        try:
            self.subject[end]
        except IndexError:
            return
        except Exception as error:
            found = type(error).__name__
        self.require(
            False,
            f"dataset[{end}] gave {found}; raise IndexError, iteration would never end.",
        )

    def _require_same(
        self, sample: SceneSample, expected: SceneSample, what: str, fix: str
    ) -> None:
        for field in fields(SceneSample):
            a, b = getattr(sample, field.name), getattr(expected, field.name)
            if isinstance(b, Tensor):
                told = f"{what} gave another sample ({field.name})"
                self.require_equal(told, a, b, fix)


class LossContract(Contract):
    """A finite scalar, less at the target than away from it, with finite gradients at both."""

    kind = "loss"
    subject: Loss

    def test_less_at_the_target_than_away_from_it(self) -> None:
        """Of a loss that compares; one that asks for no target holds the scene to a rule alone."""
        at, away = (self._inputs(distance) for distance in (0, 0.2))
        assert away.target is not None and away.reference is not None
        assert away.depths is not None and away.geometry is not None
        other = replace(
            away,
            target=1 - away.target,
            reference=replace(away.reference, means=away.reference.means + 1),
            depths=2 * away.depths,
            geometry=replace(away.geometry, depths=2 * away.geometry.depths),
        )
        values = [self._value(inputs).item() for inputs in (at, away, other)]
        if values[1] == values[2]:
            return
        self.require(
            values[0] < values[1],
            f"at the target it is {values[0]:.4g}, away from it {values[1]:.4g}; it must grow with "
            "the difference.",
        )

    def test_gradients_are_finite(self) -> None:
        for distance in (0.2, 0.0):
            inputs = self._inputs(distance)
            rendered = inputs.rendered.clone().requires_grad_()
            own = {
                name: getattr(inputs.gaussians, name).clone().requires_grad_()
                for name in PER_GAUSSIAN
            }
            gaussians = replace(inputs.gaussians, **own)
            render = partial(self._rasterizer.render, gaussians)
            given = {"rendered": rendered, "gaussians": gaussians, "render": render}
            value = self._value(replace(inputs, **given))
            leaves = [rendered, *own.values()]
            found = torch.autograd.grad(value, leaves, allow_unused=True)
            largest = max(g.abs().max() for g in found if g is not None)  # NaN stays
            place = f"its gradient {distance} from the target"
            self.require(
                torch.isfinite(largest),
                f"{place} is not finite; use a smooth norm, sqrt(x) has none at 0.",
            )
            self.require(
                distance == 0 or largest > 0,
                f"{place} is zero; it would teach nothing.",
            )

    def test_leaves_its_inputs_alone(self) -> None:
        inputs = self._inputs(distance=0.2)
        self.require_untouched(inputs.rendered, lambda: self._value(inputs))

    def _value(self, inputs: LossInputs) -> Float[Tensor, ""]:
        with torch.random.fork_rng():
            torch.manual_seed(0)  # for one that samples
            value = self.ask(asking.loss, inputs)
        self.require_tensor("the loss", value, ())
        return value

    def _inputs(self, distance: float) -> LossInputs:
        """Images and Gaussians that lie `distance` from their targets."""
        cloud = gaussian_cloud(48, batch=2)
        cameras = cameras_around(2, batch=2).to(self.device)
        truth = self._rasterizer.render(cloud.to(self.device), cameras)
        target = truth.images.clamp(0, 1)
        of_views = torch.arange(2).repeat_interleave(24)
        reference = replace(cloud, view_index=of_views)
        generator = torch.Generator().manual_seed(5)
        noise = torch.rand(target.shape, generator=generator).to(target)
        shift = torch.randn(reference.means.shape, generator=generator)
        gaussians = replace(
            reference,
            means=reference.means + distance * shift,
            scales=reference.scales * (1 + distance),
        )
        moved = gaussians.to(self.device)
        return LossInputs(
            rendered=torch.lerp(target, noise, distance),
            target=target,
            gaussians=moved,
            reference=reference.to(self.device),
            cameras=cameras,
            depths=truth.depths[:, :, 0],
            render=partial(self._rasterizer.render, moved),
            geometry=Geometry(
                cameras.c2w,
                truth.depths[:, :, 0].clamp(min=0.1),
                truth.alphas[:, :, 0],
                torch.ones(2, 2, dtype=torch.bool, device=self.device),
            ),
        )

    @cached_property
    def _rasterizer(self) -> Rasterizer:
        return reference_rasterizer()


class TrainerContract(Contract):
    """Trains a tiny network for the steps its settings say, and leaves a folder with a checkpoint.

    Set `settings` to a recipe of a few steps; the reconstructor, data and loss are made by formula.
    """

    kind = "trainer"
    subject: Trainer

    def test_trains_and_returns_the_folder_of_a_checkpoint(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            job = tiny_job(Path(folder).resolve())
            weight = job.reconstructor.network.weight
            before = weight.detach().clone()
            self.ask(asking.train, job)
            self.require(
                not torch.equal(before, weight),
                "no weight moved; step the optimiser of reconstructor.network.",
            )

    def test_resumes(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            job = tiny_job(Path(folder))
            self.ask(asking.train, job)
            again = replace(tiny_job(Path(folder)), resume=True)
            self.ask(asking.train, again)


class _PixelReconstructor(Reconstructor):
    """One Gaussian per pixel at a fixed depth, its colour from a learned 1x1 convolution."""

    settings = Settings()

    def __init__(self) -> None:
        self._network = nn.Conv2d(3, 3, 1, bias=False)
        with torch.no_grad():
            self._network.weight.copy_(0.5 * torch.eye(3)[..., None, None])

    @property
    def network(self) -> nn.Module:
        return self._network

    def __call__(
        self,
        views: Views,
        source: Views | None = None,
        geometry: Geometry | None = None,
        grid: tuple[int, int] | None = None,
    ) -> Reconstruction:
        images = views.images
        colours = self._network(images.flatten(0, 1)).view_as(images)
        poses = torch.eye(4).expand(*images.shape[:2], 4, 4)
        cameras = Cameras(poses, views.intrinsics, views.image_size)
        depths = torch.full_like(images[:, :, 0], 3.0)
        scales = depths / images.shape[-1]
        opacities = torch.full_like(depths, 0.6)
        gaussians = pixels_to_gaussians(colours, depths, cameras, scales, opacities)
        return Reconstruction(gaussians, cameras)


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
            context_masks=scene.objects[:, 0, context],
            target_masks=scene.objects[:, 0, target],
            name=f"formula-{index}",
        )


class _MeanSquares(Loss):
    settings = Settings()

    def __call__(self, inputs: LossInputs) -> Float[Tensor, ""]:
        return F.mse_loss(inputs.rendered, inputs.target)


class _TrueMatcher(Matcher):
    def match(self, views: Views) -> Geometry:
        return true_geometry(views)


def tiny_job(out: Path) -> TrainingJob:
    """A training that takes seconds: a network of one layer, four scenes by formula, one loss."""
    return TrainingJob(
        reconstructor=_PixelReconstructor(),
        matcher=_TrueMatcher(),
        rasterizer=reference_rasterizer(),
        train_data=_FormulaScenes(),
        validation_data=_FormulaScenes(),
        losses={"mean-squares": (1.0, _MeanSquares())},
        out=out,
    )
