import json
import os
import signal
from dataclasses import replace
from typing import ClassVar

import pytest
import safetensors.torch
import torch
from edit3r_training.recolor_trainer import RecolorTrainer

from edit3r.errors import MatchingError
from edit3r.interfaces import TrainingJob
from edit3r.registry import build
from edit3r.reporting import Report, collecting
from edit3r.testing import TrainerContract
from edit3r.training.checkpoint import LAST


class TestRecolorTrainer(TrainerContract):
    component = "recolor"
    settings: ClassVar = {"steps": 2, "batch": 2, "log_every": 1}


def _trainer(**settings) -> RecolorTrainer:
    settings = {"batch": 2, "warmup": 2, "log_every": 1, "validate_every": 2, "render_every": 2, **settings}
    return RecolorTrainer(RecolorTrainer.Settings(**settings))


def _job(out, **changes) -> TrainingJob:
    torch.manual_seed(0)
    reconstructor = build("reconstructor", "edit3r", weights="untrained", network_size=32)
    data = build("dataset", "procedural", image_size=32, scenes=4, targets=1, keep=True)
    losses = {"mse": (1.0, build("loss", "mse")), "geometry": (0.1, build("loss", "geometry", samples=32))}
    job = TrainingJob(reconstructor, build("rasterizer", "torch"), data, data, losses, out)
    return replace(job, **changes)


def _weights(job) -> dict:
    return {name: tensor.clone() for name, tensor in job.reconstructor.network.state_dict().items()}


class _StopAt:
    """Data that sends this process a signal when sample number `at` is asked for."""

    def __init__(self, data, at: int, number: int) -> None:
        self.data, self.at, self.number, self.asked = data, at, number, 0

    def __len__(self) -> int:
        return len(self.data)

    def __getitem__(self, index: int):
        self.asked += 1
        if self.asked == self.at:
            os.kill(os.getpid(), self.number)
        return self.data[index]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stopped_and_resumed_run_has_the_straight_run_s_weights(tmp_path, number):
    straight = _job(tmp_path / "straight")
    _trainer(steps=4).train(straight)
    stopped = _job(tmp_path / "stopped")
    data = _StopAt(stopped.train_data, at=4, number=number)  # the first is looked at before the first step
    _trainer(steps=4).train(replace(stopped, train_data=data))
    assert torch.load(tmp_path / "stopped" / LAST, weights_only=True)["step"] == 2
    resumed = _job(tmp_path / "stopped", resume=True)
    _trainer(steps=4).train(resumed)
    expected = _weights(straight)
    for name, tensor in _weights(resumed).items():
        assert torch.equal(tensor, expected[name]), name
    best = [safetensors.torch.load_file(tmp_path / run / "best/weights.safetensors") for run in ("straight", "stopped")]
    assert all(torch.equal(best[0][name], best[1][name]) for name in best[0])


def test_a_step_that_is_not_finite_is_skipped_and_counted(tmp_path):
    job = _job(tmp_path)

    class Broken:
        def __call__(self, inputs):
            return inputs.rendered.sum() * float("nan")

    before = _weights(job)
    report = Report()
    with collecting(report):
        _trainer(steps=1, render_every=1).train(replace(job, losses={"broken": (1.0, Broken())}))
    assert all(torch.equal(tensor, before[name]) for name, tensor in _weights(job).items())
    assert any("skipped" in warning for warning in report.warnings)
    line = json.loads((tmp_path / "log.jsonl").read_text().splitlines()[0])
    assert line["skipped"] == 1


def test_photos_that_cannot_be_matched_are_left_out_and_said(tmp_path):
    class Unmatched:
        network = torch.nn.Linear(2, 2)

        def __call__(self, views, source=None):
            raise MatchingError("too little in common")

    job = replace(_job(tmp_path), reconstructor=Unmatched())
    before = _weights(job)
    report = Report()
    with collecting(report):
        _trainer(steps=2).train(job)
    assert all(torch.equal(tensor, before[name]) for name, tensor in _weights(job).items())
    assert any("too little in common" in warning for warning in report.warnings)
    assert [json.loads(line)["skipped"] for line in (tmp_path / "log.jsonl").read_text().splitlines()] == [1, 2]


def test_training_lowers_the_error_it_is_given(tmp_path):
    job = _job(tmp_path)
    _trainer(steps=9, render_every=0, validate_every=3, lr=3e-3, average=0).train(job)
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    scores = [line["score"] for line in lines if line["kind"] == "validation"]
    assert min(scores[1:]) < scores[0]


def test_logs_sheets_and_best_weights_are_left_behind(tmp_path):
    best = _trainer(steps=2).train(_job(tmp_path))
    assert (best / "weights.safetensors").is_file()
    assert (tmp_path / "sheets" / "0000002.png").is_file()
    kinds = [json.loads(line)["kind"] for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert kinds.count("train") == 2 and kinds.count("validation") == 1
