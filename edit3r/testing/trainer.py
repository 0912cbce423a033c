"""Contract of a trainer."""

import tempfile
from dataclasses import replace
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from edit3r.config import Settings
from edit3r.geometry.unproject import pixels_to_gaussians
from edit3r.interfaces import Dataset, Loss, LossInputs, Reconstructor, SceneSample, Trainer, TrainingJob
from edit3r.registry import default_registry
from edit3r.testing.contract import Contract
from edit3r.testing.rasterizer import REFERENCE
from edit3r.testing.scenes import photograph
from edit3r.types import Cameras, Reconstruction, Views


class TrainerContract(Contract):
    """Trains a tiny network for the steps its settings say, and leaves a folder with a checkpoint.

    Set `settings` to a recipe of a few steps; the reconstructor, data and loss are made by formula.
    """

    kind = "trainer"
    subject: Trainer

    def test_trains_and_returns_the_folder_of_a_checkpoint(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            job = _tiny_job(Path(folder))
            before = job.reconstructor.network.weight.detach().clone()
            best = self.call("train()", self.subject.train, job)
            self.require(isinstance(best, Path), f"train() returned a {type(best).__name__}; return the folder's Path.")
            inside = best.is_dir() and Path(folder).resolve() in (best.resolve(), *best.resolve().parents)
            self.require(inside, f"train() returned {best}, which is no folder in job.out; write nothing elsewhere.")
            self.require(any(best.iterdir()), f"{best.name}/ is empty; save a checkpoint there.")
            after = job.reconstructor.network.weight.detach()
            self.require(
                not torch.equal(before, after), "no weight moved; step the optimiser of reconstructor.network."
            )

    def test_resumes(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            self.call("train()", self.subject.train, _tiny_job(Path(folder)))
            again = self.call(
                "train() with resume=True", self.subject.train, replace(_tiny_job(Path(folder)), resume=True)
            )
            self.require(again.is_dir(), f"a resumed training returned {again}, which is no folder.")


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

    def __call__(self, views: Views, source: Views | None = None) -> Reconstruction:
        batch, count, _, height, width = views.images.shape
        colours = self._network(views.images.flatten(0, 1)).unflatten(0, (batch, count))
        c2w = torch.eye(4).expand(batch, count, 4, 4)
        depths = torch.full((batch, count, height, width), 3.0)
        cameras = Cameras(c2w, views.intrinsics, views.image_size)
        scales, opacities = torch.full_like(depths, 3.0 / width), torch.full_like(depths, 0.6)
        return Reconstruction(pixels_to_gaussians(colours, depths, cameras, scales, opacities), cameras)


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

    def __call__(self, inputs: LossInputs) -> Tensor:
        return F.mse_loss(inputs.rendered, inputs.target)


def _tiny_job(out: Path) -> TrainingJob:
    rasterizer = default_registry().build("rasterizer", REFERENCE)
    losses = {"mean-squares": (1.0, _MeanSquares())}
    return TrainingJob(_PixelReconstructor(), rasterizer, _FormulaScenes(), _FormulaScenes(), losses, out)
