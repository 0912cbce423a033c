from dataclasses import replace

import pytest
import torch
from edit3r_training.asymmetric_inputs import RegimeShares
from edit3r_training.batches import make_batch
from edit3r_training.recolor_trainer import GeometricReference, RecolorTrainer
from edit3r_training.schedule import step_generator

from edit3r.contract.interfaces import Reconstructor
from edit3r.loading.registry import build
from edit3r_testing.training import tiny_job

from .training_kit import Data


class WithoutDepths(Data):
    """The formula scenes as photos are: nobody knows their depths."""

    def __getitem__(self, index: int):
        return replace(self.data[index], context_depths=None)


class MovingReconstructor(Reconstructor):
    """Puts the tiny job's Gaussians at a depth that is learned, the farther off the brighter the
    reference is.
    """

    network = None

    def __init__(self, inner) -> None:
        self.inner = inner
        self.network = torch.nn.Linear(1, 1)

    def __call__(self, views, source=None, geometry=None, grid=None):
        answer = self.inner(views, source)
        means = answer.gaussians.means * (1 + self.network.weight * 0.1)
        means = means + 10 * views.images[:, 0].mean()
        return replace(answer, gaussians=replace(answer.gaussians, means=means))


def _job(out, depths: bool):
    job = tiny_job(out)
    data = job.train_data if depths else WithoutDepths(job.train_data)
    reconstructor = MovingReconstructor(job.reconstructor)
    job = replace(job, train_data=data, validation_data=None)
    losses = {"center": (1.0, build("loss", "center", beta=0.1))}
    return replace(job, reconstructor=reconstructor, losses=losses)


def _batch(job):
    """One scene, edited in its reference view."""
    shares = RegimeShares(reference=1, disagreeing=0, agreeing=0, unedited=0)
    return make_batch([job.train_data[0]], shares, [step_generator(0, 0, 0)])


def test_true_depths_are_the_reference_where_there_are_any(tmp_path):
    job = _job(tmp_path, depths=True)
    reference, batch = GeometricReference.of_start(job), _batch(job)
    made = job.reconstructor(batch.edited)
    assert reference.frozen is None
    assert torch.equal(reference(batch, made).means, batch.true_centres())


def test_nothing_holds_centres_where_an_edit_may_have_moved_the_surface(tmp_path):
    job = _job(tmp_path, depths=True)
    batch = _batch(job)
    made = job.reconstructor(batch.edited)
    gaussians = made.gaussians
    moved = torch.zeros_like(batch.reshaped)
    moved[:, 1, :, :5] = True
    reference = GeometricReference()(replace(batch, reshaped=moved), made)
    free = moved.flatten()
    assert torch.equal(reference.means[:, free], gaussians.means.detach()[:, free])
    assert torch.equal(reference.means[:, ~free], batch.true_centres()[:, ~free])


def test_without_depths_the_frozen_network_s_centres_of_the_unedited_photos_are(
    tmp_path,
):
    job = _job(tmp_path, depths=False)
    reference, batch = GeometricReference.of_start(job), _batch(job)
    start = job.reconstructor(batch.source).gaussians.means.detach()
    with torch.no_grad():
        job.reconstructor.network.weight.add_(1)
    moved = job.reconstructor(batch.edited)
    held = reference(batch, moved).means
    assert torch.equal(held, start) and not held.requires_grad
    edited = MovingReconstructor(job.reconstructor.inner)(batch.edited)
    assert not torch.allclose(held, edited.gaussians.means, atol=1e-3)
    assert not torch.allclose(held, moved.gaussians.means)


def test_a_named_reference_wins_over_the_true_surface_and_stays_frozen(tmp_path):
    job = _job(tmp_path, depths=True)
    named = MovingReconstructor(job.reconstructor.inner)
    job = replace(job, reference=named)
    reference, batch = GeometricReference.of_start(job), _batch(job)
    held = reference(batch, job.reconstructor(batch.edited)).means
    assert torch.equal(held, named(batch.source).gaussians.means.detach())
    assert not torch.allclose(held, batch.true_centres(), atol=1e-3)
    before = named.network.weight.detach().clone()
    off = {"colour": 0, "depth": 0, "opacity": 0}
    RecolorTrainer(RecolorTrainer.Settings(steps=2, batch=1, **off)).train(job)
    assert torch.equal(named.network.weight, before)
    assert not named.network.weight.requires_grad


@pytest.mark.slow
def test_the_center_loss_trains_on_photos_and_resuming_keeps_the_first_reference(
    tmp_path,
):
    """Resumed after half of the steps, the reference is still the network before the first."""

    def weights(name: str, *steps_and_resume) -> torch.Tensor:
        for steps, resume in steps_and_resume:
            torch.manual_seed(0)
            job = replace(_job(tmp_path / name, depths=False), resume=resume)
            shared = {"batch": 1, "warmup": 100, "colour": 0, "weight_decay": 1}
            settings = RecolorTrainer.Settings(steps=steps, lr=0.1, **shared)
            RecolorTrainer(settings).train(job)
        return job.reconstructor.network.weight.detach()

    straight = weights("straight", (4, False))
    resumed = weights("resumed", (2, False), (4, True))
    assert torch.equal(straight, resumed)


def test_the_frozen_reference_is_in_evaluation_mode_while_the_network_learns(tmp_path):
    """Layers that are random or keep statistics while they learn would move what must stay."""
    job = _job(tmp_path, depths=False)
    job.reconstructor.network.train()
    frozen = GeometricReference.of_start(job).frozen.reconstructor
    assert frozen is not job.reconstructor and not frozen.network.training
    assert job.reconstructor.network.training
    named = replace(job, reference=MovingReconstructor(job.reconstructor))
    named.reference.network.train()
    assert not GeometricReference.of_start(named).frozen.reconstructor.network.training
