import signal
import threading
from dataclasses import replace
from typing import ClassVar

import pytest
import safetensors.torch
import torch
from edit3r_training.asymmetric_inputs import RegimeShares
from edit3r_training.batches import make_batch
from edit3r_training.checkpoint import LAST
from edit3r_training.processes import Processes
from edit3r_training.recolor_trainer import (
    RecolorRecipe,
    RecolorTrainer,
    _supervised_views,
)
from edit3r_training.schedule import step_generator
from edit3r_training.validation import held_out_batches, held_out_measures

from edit3r.contract.errors import MatchingError, PluginError, SettingsError
from edit3r.contract.interfaces import Geometry, Matcher, Reconstructor, TrainingJob
from edit3r.contract.reporting import Report, collecting, warn
from edit3r.contract.types import Rendering
from edit3r.kit.geometry.cameras import scale_poses
from edit3r.loading.registry import build
from edit3r_testing import TrainerContract
from edit3r_testing.training import tiny_job

from .training_kit import Data, log_of


class TestRecolorTrainer(TrainerContract):
    component = "recolor"
    settings: ClassVar = {"steps": 2, "batch": 2, "log_every": 1}


def _trainer(**settings) -> RecolorTrainer:
    usual = {"batch": 2, "warmup": 2, "log_every": 1, "validate_every": 2}
    given = usual | {"render_every": 2} | settings
    return RecolorTrainer(RecolorTrainer.Settings(**given))


def _job(out, **changes) -> TrainingJob:
    torch.manual_seed(0)
    drawn = {"image_size": 32, "scenes": 4, "targets": 1, "keep": True, "textures": 8}
    data = build("dataset", "procedural", **drawn)
    losses = {
        "mse": (1.0, build("loss", "mse")),
        "geometry": (0.1, build("loss", "geometry", samples=32)),
    }
    job = TrainingJob(
        reconstructor=build(
            "reconstructor", "edit3r", weights="untrained", network_size=32
        ),
        matcher=build("matcher", "classical"),
        rasterizer=build("rasterizer", "torch"),
        train_data=data,
        validation_data=data,
        losses=losses,
        out=out,
    )
    return replace(job, **changes)


class _TrueMatcher(Matcher):
    """Gives the true geometry of one sample, in a unit a third as long, and counts how often it is
    asked.
    """

    def __init__(self, sample, places: bool = True) -> None:
        self.sample, self.places, self.asked = sample, places, 0

    def match(self, views):
        self.asked += 1
        assert torch.equal(views.images[0], self.sample.context)
        if not self.places:
            raise MatchingError("nothing matches.")
        cameras, depths = self.sample.context_cameras, self.sample.context_depths[None]
        c2w = scale_poses(cameras.c2w, torch.full((1, 1), 3.0))
        return Geometry(
            c2w, 3 * depths, torch.ones_like(depths), torch.ones(1, 2, dtype=torch.bool)
        )


@pytest.mark.parametrize("places", [True, False])
def test_geometry_is_the_matcher_s_own_where_asked_for_and_the_truth_is_in_its_unit(
    tmp_path, places
):
    job = _job(tmp_path)
    sample = job.train_data[0]
    matcher = _TrueMatcher(sample, places)
    job = replace(job, matcher=matcher)
    job = replace(job, train_data=Data([sample]))
    recipe = RecolorRecipe(_trainer(batch=2, matched=1.0).settings, job)
    first, second = (recipe._batch(step, Processes()) for step in range(2))
    assert matcher.asked == 1  # once for a scene, however often it is drawn
    for batch in (first, second):
        exact = torch.allclose(batch.geometry.depths, batch.depths, rtol=1e-5)
        assert exact == places  # what cannot be placed is simulated
    if places:
        assert torch.allclose(
            first.depths, 3 * sample.context_depths.expand_as(first.depths)
        )
        assert torch.allclose(first.context_cameras.c2w, first.geometry.c2w)
    RecolorRecipe(_trainer(batch=2).settings, job)._batch(0, Processes())
    assert matcher.asked == 1  # not asked for: simulated


def _weights(job) -> dict:
    return {
        name: tensor.clone()
        for name, tensor in job.reconstructor.network.state_dict().items()
    }


def _same(some: dict, others: dict) -> bool:
    return all(torch.equal(tensor, others[name]) for name, tensor in some.items())


class _StopAt(Data):
    """Sends this process a SIGTERM when sample number `at` is asked for."""

    def __init__(self, data, at: int) -> None:
        super().__init__(data)
        self.at, self.asked = at, 0

    def __getitem__(self, index: int):
        self.asked += 1
        if self.asked == self.at:
            signal.raise_signal(signal.SIGTERM)
        return self.data[index]


@pytest.mark.slow
def test_a_stopped_and_resumed_run_has_the_straight_run_s_weights(tmp_path):
    """SIGTERM ends the second step first; Ctrl-C is tested with the loop."""
    straight = tiny_job(tmp_path / "straight")
    _trainer(steps=4).train(straight)
    stopped = tiny_job(tmp_path / "stopped")
    # the first is looked at before the first step
    data = _StopAt(stopped.train_data, at=4)
    _trainer(steps=4).train(replace(stopped, train_data=data))
    assert torch.load(tmp_path / "stopped" / LAST, weights_only=True)["step"] == 2
    resumed = replace(tiny_job(tmp_path / "stopped"), resume=True)
    _trainer(steps=4).train(resumed)
    assert _same(_weights(resumed), _weights(straight))
    best = [
        safetensors.torch.load_file(tmp_path / run / "best/weights.safetensors")
        for run in ("straight", "stopped")
    ]
    assert _same(*best)


@pytest.mark.slow
def test_a_step_that_is_not_finite_is_skipped_and_counted(tmp_path):
    job = tiny_job(tmp_path)

    class Broken:
        def __call__(self, inputs):
            return inputs.rendered.sum() * float("nan")

    before = _weights(job)
    report = Report()
    with collecting(report):
        _trainer(steps=1, render_every=1).train(
            replace(job, losses={"broken": (1.0, Broken())})
        )
    assert _same(_weights(job), before)
    assert "step 1 was skipped: its loss 'broken' is nan." in report.warnings
    assert log_of(tmp_path)[0]["skipped"] == 1


def test_photos_that_cannot_be_matched_are_left_out_and_said(tmp_path):
    class Unmatched(Reconstructor):
        network = torch.nn.Linear(2, 2)

        def __call__(self, views, source=None, geometry=None, grid=None):
            raise MatchingError("too little in common")

    job = replace(_job(tmp_path), reconstructor=Unmatched())
    before = _weights(job)
    report = Report()
    with collecting(report):
        _trainer(steps=2).train(job)
    assert _same(_weights(job), before)
    assert any("too little in common" in warning for warning in report.warnings)
    assert [line["skipped"] for line in log_of(tmp_path)] == [1, 2]


class _Spy:
    """Stands between a recipe and its reconstructor, rasterizer and loss, and keeps what each is
    given last.
    """

    def __init__(self, job: TrainingJob, **settings) -> None:
        self.uses_geometry = job.reconstructor.uses_geometry
        self.gives = job.rasterizer.gives
        self.reconstructor, self.rasterizer = job.reconstructor, job.rasterizer
        self.network = job.reconstructor.network
        losses = {"spy": (1.0, self.compare)}
        job = replace(job, reconstructor=self, rasterizer=self, losses=losses)
        given = {"batch": 1, "colour": 0, "depth": 0, "opacity": 0} | settings
        self.recipe = RecolorRecipe(RecolorTrainer.Settings(**given), job)

    def __call__(self, views, source=None, geometry=None, grid=None):
        self.edited, self.source = views.images, source.images
        return self.reconstructor(views, source, geometry)

    def render(self, gaussians, cameras):
        self.shown, self.cameras = set(gaussians.view_index.tolist()), cameras.count
        return self.rasterizer.render(gaussians, cameras)

    def compare(self, inputs):
        self.wished = inputs.target
        return (inputs.rendered - inputs.target).square().mean()

    def step(self, number: int = 0) -> None:
        self.recipe.begin()
        self.recipe.loss(number, Processes())


ONLY_REFERENCE = {"reference": 1, "disagreeing": 0, "agreeing": 0, "unedited": 0}
ONLY_REFERENCE |= {"mask_jitter": 0, "whole_picture": 1}


def test_renderings_are_compared_with_the_edited_scene_in_every_view(tmp_path):
    job = tiny_job(tmp_path)
    spy = _Spy(job, regimes=ONLY_REFERENCE, drop_first=0)
    spy.step()
    targets = [job.train_data[index].target[0] for index in range(len(job.train_data))]
    # novel views show it too
    assert min((spy.wished[0, 2] - target).abs().mean() for target in targets) > 0.02
    assert spy.wished.shape[1] == 3  # two context views and a target view
    # the reference is right as it is
    assert torch.equal(spy.wished[:, 0], spy.edited[:, 0])
    # the other view is given unedited
    assert torch.equal(spy.edited[:, 1], spy.source[:, 1])
    # and must show the edit
    assert (spy.wished[:, 1] - spy.source[:, 1]).abs().mean() > 0.02


def test_dropping_the_first_view_leaves_its_gaussians_and_its_image_out(tmp_path):
    spy = _Spy(tiny_job(tmp_path), drop_first=1)
    spy.step()
    assert spy.shown == {1} and spy.cameras == spy.wished.shape[1] == 2
    spy = _Spy(tiny_job(tmp_path), drop_first=0)
    spy.step()
    assert spy.shown == {0, 1} and spy.cameras == spy.wished.shape[1] == 3


@pytest.mark.slow
def test_the_first_view_is_dropped_as_often_as_asked(tmp_path):
    """By default half of the time, as in the paper."""
    spy, dropped = _Spy(tiny_job(tmp_path)), 0
    for number in range(40):
        spy.step(number)
        dropped += spy.shown == {1}
    assert 12 <= dropped <= 28


def test_a_loss_without_a_gradient_is_a_sentence(tmp_path):
    class Frozen(Reconstructor):
        network = torch.nn.Linear(2, 2)

        def __call__(self, views, source=None, geometry=None, grid=None):
            with torch.no_grad():
                return inner(views, source)

    job = tiny_job(tmp_path)
    inner = job.reconstructor
    with pytest.raises(
        PluginError,
        match=r"step 1 does not depend on the network's weights.*torch.no_grad",
    ):
        _trainer(steps=1).train(replace(job, reconstructor=Frozen()))


@pytest.mark.slow
def test_a_training_begun_anew_leaves_no_checkpoint_of_the_one_before(tmp_path):
    """A run that is killed before its first checkpoint must not be resumed from another one's."""
    _trainer(steps=1).train(tiny_job(tmp_path))
    assert (tmp_path / LAST).is_file()

    class Killed:
        def __call__(self, inputs):
            raise SystemExit

    with pytest.raises(PluginError):
        _trainer(steps=2, render_every=1).train(
            replace(tiny_job(tmp_path), losses={"killed": (1.0, Killed())})
        )
    assert not (tmp_path / LAST).exists()


@pytest.mark.slow
def test_training_lowers_the_error_it_is_given(tmp_path):
    job = _job(tmp_path)
    _trainer(steps=9, render_every=0, validate_every=3, lr=3e-3, average=0).train(job)
    validations = [one for one in log_of(tmp_path) if one["kind"] == "validation"]
    scores = [line["score"] for line in validations]
    assert min(scores[1:]) < scores[0]


@pytest.mark.slow
def test_logs_sheets_and_best_weights_are_left_behind(tmp_path):
    best = _trainer(steps=2).train(tiny_job(tmp_path))
    assert (best / "weights.safetensors").is_file()
    assert (tmp_path / "sheets" / "0000002.png").is_file()
    kinds = [line["kind"] for line in log_of(tmp_path)]
    assert kinds.count("train") == 2 and kinds.count("validation") == 1


@pytest.mark.parametrize("workers", [0, 2])
def test_data_is_told_how_far_the_training_is(tmp_path, workers):
    asked = set()

    class Noted(Data):
        def at_progress(self, index: int, progress: float):
            asked.add(progress)
            return self.data[index]

    job = tiny_job(tmp_path)
    data = Noted(job.train_data)
    settings = RecolorTrainer.Settings(batch=1, workers=workers, steps=4, accumulate=2)
    recipe = RecolorRecipe(settings, replace(job, train_data=data))
    recipe.begin()
    for batch in range(7):
        recipe.loss(batch, Processes())
    # a worker may be one ahead
    assert asked - {7 / 8} == {batch / 8 for batch in range(7)}


def test_workers_load_ahead_and_change_nothing(tmp_path):
    class Noted(Data):
        def __getitem__(self, index: int):
            threads.add(threading.get_ident())
            warn(f"sample {index}")
            return self.data[index]

    weights, own, threads = [], threading.get_ident(), set()
    for workers in (0, 2):
        job = tiny_job(tmp_path / str(workers))
        data, report = Noted(job.train_data), Report()
        recipe = RecolorRecipe(
            RecolorTrainer.Settings(batch=2, workers=workers),
            replace(job, train_data=data),
        )
        recipe.begin()
        threads.clear()
        with collecting(report):
            total = sum(recipe.loss(step, Processes()).total for step in range(3))
        assert (own in threads) == (workers == 0) and report.warnings
        weights.append(float(total.detach()))
    assert weights[0] == weights[1]


def test_the_baseline_is_the_unit_for_networks_that_see_images_alone(tmp_path):
    job = tiny_job(tmp_path)
    given = [job.train_data[index] for index in range(2)]
    numbers = [step_generator(0, 0, slot) for slot in range(2)]
    batch = make_batch(given, RegimeShares(unedited=1), numbers, unit="baseline")
    assert batch.geometry is None  # nobody matched anything
    assert torch.allclose(
        batch.context_cameras.c2w[:, -1, :3, 3].norm(dim=-1), torch.ones(2)
    )
    for item, sample in enumerate(given):
        unit = sample.context_cameras.c2w[0, -1, :3, 3].norm()
        assert torch.allclose(batch.depths[item] * unit, sample.context_depths)
        moved = batch.target_cameras.c2w[item, :, :3, 3] * unit
        assert torch.allclose(moved, sample.target_cameras.c2w[0, :, :3, 3], atol=1e-6)


@pytest.mark.slow
def test_rendered_novel_views_of_the_edited_scene_can_be_the_score(tmp_path):
    job = tiny_job(tmp_path)
    _trainer(steps=2, score="renderings", regimes=ONLY_REFERENCE).train(job)
    (measured,) = [one for one in log_of(tmp_path) if one["kind"] == "validation"]
    assert measured["score"] == measured["novel"] > 0 and "uptake" in measured
    _trainer(steps=2, regimes=ONLY_REFERENCE).train(
        replace(job, out=tmp_path / "pixels")
    )
    assert all("novel" not in line for line in log_of(tmp_path / "pixels"))


def test_the_score_of_renderings_is_their_error_to_the_edited_novel_views(tmp_path):
    job, shares = tiny_job(tmp_path), RegimeShares(**ONLY_REFERENCE)
    batches = held_out_batches(job.validation_data, shares, 4, "baseline")
    (batch,) = batches

    class Answer:
        gives = ("images",)

        def __init__(self, images) -> None:
            self.images = images

        def render(self, gaussians, cameras):
            assert torch.equal(cameras.c2w, batch.target_cameras.c2w)
            return Rendering(self.images)

    def score(images) -> float:
        drawn = replace(job, rasterizer=Answer(images))
        return held_out_measures(drawn, Processes(), batches, True, None)["score"]

    unedited = torch.stack([sample.target for sample in job.validation_data])
    assert score(batch.target) == 0
    assert score(batch.target + 0.1) == pytest.approx(0.01, rel=1e-3)
    assert score(unedited) > 1e-3


def test_a_score_of_renderings_without_novel_views_is_a_sentence(tmp_path):
    class ContextAlone(Data):
        def __getitem__(self, index: int):
            sample = self.data[index]
            none, masks = sample.target[:0], sample.target_masks[:, :0]
            cameras = sample.target_cameras.select([])
            return replace(
                sample, target=none, target_masks=masks, target_cameras=cameras
            )

    job = tiny_job(tmp_path)
    job = replace(job, validation_data=ContextAlone(job.validation_data))
    with pytest.raises(
        SettingsError,
        match=r"trainer\.score: renderings need held-out scenes with novel views",
    ):
        _trainer(steps=1, score="renderings").train(job)


def test_without_pixel_by_pixel_terms_any_set_of_gaussians_can_be_trained(tmp_path):
    job = tiny_job(tmp_path)
    inner = job.reconstructor

    class Half(Reconstructor):
        """Every second pixel alone has a Gaussian."""

        network = inner.network
        uses_geometry = inner.uses_geometry

        def __call__(self, views, source=None, geometry=None, grid=None):
            answer = inner(views, source, geometry)
            second = torch.arange(0, answer.gaussians.count, 2)
            return replace(answer, gaussians=answer.gaussians.select(second))

    job = replace(job, reconstructor=Half(), validation_data=None)
    before = inner.network.weight.detach().clone()
    off = {"colour": 0, "depth": 0, "opacity": 0, "drop_first": 0}
    _trainer(steps=1, render_every=1, **off).train(job)
    assert not torch.equal(inner.network.weight, before)


@pytest.mark.parametrize("first", [0, 1])
def test_where_an_edit_reshaped_a_view_its_true_depth_is_not_compared(tmp_path, first):
    """Also where the first view is dropped, and the views move up by one."""
    recipe = RecolorRecipe(_trainer(batch=1).settings, _job(tmp_path))
    batch = recipe._batch(0, Processes())
    reshaped = torch.zeros_like(batch.depths, dtype=torch.bool)
    reshaped[:, 1, :16] = True
    cameras, _, depths = _supervised_views(replace(batch, reshaped=reshaped), first)
    assert depths.shape[1] == cameras.count == 3 - first
    expected = torch.where(reshaped, 0.0, batch.depths)[:, first:]
    assert torch.equal(depths[:, :-1], expected)
    assert not depths[:, -1].any()  # of the novel view
