"""One process on its own; two are tested with the trainer that uses them."""

import pytest
import torch
from edit3r_training.processes import (
    Processes,
    is_first_process,
    joined_processes,
    own_device,
)

from edit3r.contract.errors import SettingsError


def test_alone_nothing_is_sent_or_changed(monkeypatch):
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    network, loss = torch.nn.Linear(2, 1), torch.tensor(3.0)
    network.weight.grad = torch.ones(1, 2)
    with joined_processes() as alone:
        assert alone == Processes(rank=0, count=1) and alone.writes
        assert alone.average_gradients(network.parameters(), loss) is loss
        alone.share_weights(network)
        assert alone.gathered([1, 2]) == [1, 2]
        assert alone.any(True) and not alone.any(False)
    assert network.bias.grad is None
    assert torch.equal(network.weight.grad, torch.ones(1, 2))
    assert not torch.distributed.is_initialized()


def test_half_an_environment_of_torchrun_is_refused(monkeypatch):
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.delenv("RANK", raising=False)
    with (
        pytest.raises(
            SettingsError, match="RANK is not; start several processes with torchrun"
        ),
        joined_processes(),
    ):
        pass


@pytest.mark.parametrize(("rank", "first"), [(None, True), ("0", True), ("1", False)])
def test_the_first_process_is_known_before_any_is_joined(monkeypatch, rank, first):
    monkeypatch.delenv("RANK", raising=False)
    if rank is not None:
        monkeypatch.setenv("RANK", rank)
    assert is_first_process() is first


def test_a_process_s_own_gpu_is_the_one_of_its_local_rank(monkeypatch):
    monkeypatch.setenv("LOCAL_RANK", "3")
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 4)
    assert own_device("cuda") == torch.device("cuda", 3)
    assert own_device("cuda:1") == torch.device("cuda", 1)
    assert own_device("cpu") == torch.device("cpu")


def test_devices_that_are_not_there_are_refused_by_name(monkeypatch):
    monkeypatch.delenv("LOCAL_RANK", raising=False)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    with pytest.raises(
        SettingsError, match="cuda:0 was asked for, but this machine has 0 GPUs"
    ):
        own_device("cuda")
    with pytest.raises(SettingsError, match="no torch device is called 'gpu'"):
        own_device("gpu")
