"""The second device of tests holds numbers and, as a GPU does, refuses to mix with the CPU."""

import threading

import numpy as np
import pytest
import torch

from edit3r_testing import second_device


@pytest.fixture
def device():
    with second_device() as device:
        yield device


def test_numbers_there_are_those_of_the_cpu(device):
    here = torch.rand(3, 4, generator=torch.Generator().manual_seed(0))
    there = here.to(device)
    assert there.device == device
    changed = there.clone()
    changed[:, [0, 2]] = 7
    changed[..., 1] += there.new_tensor([1, 2, 3])
    expected = here.clone()
    expected[:, [0, 2]] = 7
    expected[..., 1] += torch.tensor([1.0, 2, 3])
    assert torch.equal(changed.cpu(), expected)
    assert torch.where(there > 0.5, there, -1.0).tolist() == (
        torch.where(here > 0.5, here, -1.0).tolist()
    )
    assert torch.equal(torch.eye(3, device=device).cpu(), torch.eye(3))


@pytest.mark.parametrize(
    "mixed",
    [
        lambda here, there: here + there,
        lambda here, there: torch.stack([here, there]),
        lambda here, there: there.clone().mul_(here),
        lambda here, there: here[there > 0],
    ],
)
def test_two_devices_do_not_mix(device, mixed):
    here = torch.ones(3)
    with pytest.raises(RuntimeError, match="same device"):
        mixed(here, here.to(device))


def test_what_a_gpu_takes_from_the_cpu_is_taken(device):
    there = torch.arange(3.0).to(device)
    there[torch.tensor([0])] = torch.tensor(5.0)
    assert (there + torch.tensor(1.0)).tolist() == [6, 2, 3]
    assert there.copy_(torch.zeros(3)).tolist() == [0, 0, 0]


@pytest.mark.parametrize("read", [np.asarray, torch.Tensor.numpy])
def test_numpy_reads_nothing_there(device, read):
    with pytest.raises(TypeError, match="numpy"):
        read(torch.ones(2).to(device))
    assert torch.ones(2).to(device).numpy(force=True).tolist() == [1, 1]


def test_random_numbers_there_need_a_generator_from_there(device):
    with pytest.raises(RuntimeError, match="generator"):
        torch.rand(3, device=device, generator=torch.Generator())


def test_gradients_come_back_from_there(device):
    here = torch.ones(3, requires_grad=True)
    (here.to(device) * 2).sum().backward()
    assert here.grad.tolist() == [2, 2, 2]


def test_threads_see_it_too_and_after_the_block_it_is_gone():
    found = []
    with second_device() as device:
        thread = threading.Thread(
            target=lambda: found.append(torch.ones(2, device=device).tolist())
        )
        thread.start()
        thread.join()
    assert found == [[1, 1]]
    with pytest.raises(NotImplementedError):
        torch.ones(2, device=device).tolist()
