import json
from dataclasses import replace

import pytest
import safetensors.torch
import torch
from edit3r_matching_network.network import MatchingNetwork, load_network, save_network
from edit3r_matching_network.trainer import GeometryRecipe, GeometryTrainer
from edit3r_training.job import prepare

from edit3r.errors import InputError, SettingsError
from edit3r.interfaces import TrainingJob
from edit3r.registry import build, default_registry

DATA = {"image_size": 32, "textures": 8, "scenes": 4, "targets": 0}


@pytest.fixture
def job(tmp_path) -> TrainingJob:
    torch.manual_seed(1)
    reconstructor = build("reconstructor", "classical", matcher={"name": "network", "weights": "untrained"})
    torch.manual_seed(1)
    reconstructor.parts["matcher"].matching_network = MatchingNetwork(width=32, fine_width=16, heads=2, after=1)
    data = build("dataset", "procedural", **DATA)
    return TrainingJob(reconstructor, build("rasterizer", "torch"), data, data, {}, tmp_path)


def _trainer(**settings) -> GeometryTrainer:
    return build("trainer", "geometry", **{"batch": 2, "warmup": 1, "log_every": 1, "pose_from": 2, **settings})


def test_training_lowers_the_error_and_leaves_weights_that_load(job):
    best = _trainer(steps=16, validate_every=16).train(job)
    lines = [json.loads(line) for line in (job.out / "log.jsonl").read_text().splitlines()]
    errors = [line["coarse"] for line in lines if line["kind"] == "train"]
    assert sum(errors[-4:]) < 0.95 * sum(errors[:4])
    assert {"rotation_median", "match_median"} <= set(next(line for line in lines if line["kind"] == "validation"))
    network = load_network(str(best / "weights.safetensors"))
    assert network.sizes == job.reconstructor.parts["matcher"].matching_network.sizes


def test_a_resumed_training_gives_the_weights_of_a_straight_one(job, tmp_path, monkeypatch):
    straight = replace(job, out=tmp_path / "straight")
    network = job.reconstructor.parts["matcher"].matching_network
    start = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    _trainer(steps=4, checkpoint_every=2).train(straight)
    expected = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    network.load_state_dict(start)
    halves = replace(job, out=tmp_path / "halves")
    trainer, loss = _trainer(steps=4, checkpoint_every=2), GeometryRecipe.loss

    def interrupted(recipe, step, processes):
        if step == 2:
            raise KeyboardInterrupt
        return loss(recipe, step, processes)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(GeometryRecipe, "loss", interrupted)
        trainer.train(halves)
    network.load_state_dict(start)
    trainer.train(replace(halves, resume=True))
    assert all(torch.equal(tensor, expected[name]) for name, tensor in network.state_dict().items())


def test_steps_that_are_not_finite_are_skipped_and_counted(job):
    network = job.reconstructor.parts["matcher"].matching_network
    with torch.no_grad():
        network.combine.weight.fill_(float("nan"))
    before = network.correct[1].weight.clone()
    _trainer(steps=2, validate_every=100).train(replace(job, validation_data=None))
    assert torch.equal(network.correct[1].weight, before)
    assert '"skipped": 2.0' in (job.out / "log.jsonl").read_text()


def test_a_reconstructor_without_this_network_is_refused(job):
    with pytest.raises(SettingsError, match=r"matcher: \{name: network"):
        _trainer(steps=1).train(replace(job, reconstructor=build("reconstructor", "classical")))


def test_the_shipped_recipe_can_be_built(tmp_path):
    from edit3r.config import find_config, merge, read_yaml

    values = merge(
        read_yaml(find_config("training/edit3r-network")),
        {"reconstructor": {"matcher": {"weights": "untrained"}}, "out": str(tmp_path)},
    )
    assert isinstance(prepare(values, default_registry())[0], GeometryTrainer)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_weights_survive_saving_in_half_precision(tmp_path, dtype):
    network = MatchingNetwork(width=32, fine_width=16, heads=2)
    weights = {name: tensor.to(dtype) for name, tensor in network.state_dict().items()}
    save_network(tmp_path / "own.safetensors", weights, network.sizes)
    for name, tensor in load_network(str(tmp_path / "own.safetensors")).state_dict().items():
        assert torch.allclose(tensor, network.state_dict()[name], rtol=1e-2, atol=1e-4), name


def test_files_that_are_not_these_weights_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such weights file"):
        load_network(str(tmp_path / "none.safetensors"))
    (tmp_path / "text.safetensors").write_text("hello")
    with pytest.raises(InputError, match="not a usable safetensors file"):
        load_network(str(tmp_path / "text.safetensors"))
    safetensors.torch.save_file({"a": torch.zeros(1)}, tmp_path / "other.safetensors")
    with pytest.raises(InputError, match="not weights of this network"):
        load_network(str(tmp_path / "other.safetensors"))
