import random

import numpy as np
import pytest
import torch
from torch import nn

from edit3r.errors import InputError, RunError
from edit3r.training.checkpoint import TrainingState, copied_weights


def _state(width: int = 3) -> TrainingState:
    torch.manual_seed(width)
    network = nn.Linear(width, 2)
    return TrainingState(network, torch.optim.AdamW(network.parameters()), copied_weights(network))


def _train(state: TrainingState, steps: int) -> None:
    for _ in range(steps):
        loss = (state.network(torch.randn(4, state.network.in_features)) - random.random() - np.random.rand()).square()
        state.optimizer.zero_grad()
        loss.mean().backward()
        state.optimizer.step()
        state.step += 1
        state.update_average(0.9)


def test_loading_continues_as_if_never_stopped(tmp_path):
    straight = _state()
    _train(straight, 3)
    straight.save(tmp_path / "last.pt")
    _train(straight, 4)
    resumed = _state(3)
    resumed.load(tmp_path / "last.pt")
    _train(resumed, 4)
    assert resumed.step == 7
    for name, tensor in straight.network.state_dict().items():
        assert torch.equal(tensor, resumed.network.state_dict()[name])
        assert torch.equal(straight.average[name], resumed.average[name])


def test_average_follows_the_weights_slowly():
    state = _state()
    state.step = 10_000
    with torch.no_grad():
        state.network.weight.add_(1.0)
    before = state.average["weight"].clone()
    state.update_average(0.9)
    assert torch.allclose(state.average["weight"] - before, torch.full_like(before, 0.1), atol=1e-6)


def test_a_checkpoint_of_another_network_is_refused(tmp_path):
    _state(3).save(tmp_path / "last.pt")
    with pytest.raises(InputError, match="another network"):
        _state(5).load(tmp_path / "last.pt")


def test_resuming_without_a_checkpoint_says_what_to_do(tmp_path):
    with pytest.raises(InputError, match="without --resume"):
        _state().load(tmp_path / "last.pt")


def test_a_failed_write_leaves_the_last_checkpoint_whole(tmp_path, monkeypatch):
    state = _state()
    state.save(tmp_path / "last.pt")
    whole = (tmp_path / "last.pt").read_bytes()

    def full(content, path):
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(torch, "save", full)
    with pytest.raises(RunError, match="No space left"):
        state.save(tmp_path / "last.pt")
    assert (tmp_path / "last.pt").read_bytes() == whole
    assert [p.name for p in tmp_path.iterdir()] == ["last.pt"]
