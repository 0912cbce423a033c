import io
import os

import pytest
import torch
from edit3r_training.checkpoint import TrainingState, copied_weights
from torch import nn

from edit3r.contract.errors import InputError, RunError
from edit3r.kit.weights.files import WEIGHTS, load_weights, save_weights


def _state(width: int = 3) -> TrainingState:
    torch.manual_seed(width)
    network = nn.Linear(width, 2)
    return TrainingState(
        network, torch.optim.AdamW(network.parameters()), copied_weights(network)
    )


def _train(state: TrainingState, steps: int) -> None:
    for _ in range(steps):
        torch.manual_seed(state.step)
        loss = (state.network(torch.randn(4, state.network.in_features)) - 1).square()
        state.optimizer.zero_grad()
        loss.mean().backward()
        state.optimizer.step()
        state.step += 1
        state.update_average(0.9)


def test_weights_that_are_not_finite_are_refused(tmp_path):
    network = nn.Linear(2, 2)
    spoiled = {name: value * torch.nan for name, value in network.state_dict().items()}
    save_weights(tmp_path / WEIGHTS, spoiled)
    with pytest.raises(InputError, match="not finite"):
        load_weights(network, tmp_path)
    assert network.weight.isfinite().all()


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


def test_what_is_set_otherwise_than_before_is_named_on_resuming(tmp_path):
    first = _state()
    first.config = {"trainer": {"name": "x", "settings": {"steps": 4}}, "out": "a"}
    first.save(tmp_path / "last.pt")
    again = _state()
    again.config = {"trainer": {"name": "x", "settings": {"steps": 6}}, "out": "b"}
    assert again.load(tmp_path / "last.pt") == []  # more steps, another place
    again.config = {"trainer": {"name": "x", "settings": {"steps": 2, "lr": 0.2}}}
    changes = ["trainer.steps: 4, now 2", "trainer.lr: not set, now 0.2"]
    assert again.load(tmp_path / "last.pt") == changes


def test_average_follows_the_weights_slowly():
    state = _state()
    state.step = 10_000
    with torch.no_grad():
        state.network.weight.add_(1.0)
    before = state.average["weight"].clone()
    state.update_average(0.9)
    assert torch.allclose(
        state.average["weight"] - before, torch.full_like(before, 0.1), atol=1e-6
    )


@pytest.mark.parametrize("part", ["network", "average"])
def test_weights_of_a_checkpoint_that_are_not_finite_are_refused(tmp_path, part):
    state = _state()
    spoiled = state.average if part == "average" else state.network.state_dict()
    spoiled["weight"].fill_(float("nan"))
    state.save(tmp_path / "last.pt")
    with pytest.raises(InputError, match="holds weights that are not finite"):
        _state().load(tmp_path / "last.pt")


def test_resuming_without_a_checkpoint_says_what_to_do(tmp_path):
    with pytest.raises(InputError, match="--overwrite instead of --resume"):
        _state().load(tmp_path / "last.pt")


class _Planted:
    """Creates a file when it is unpickled, as a stranger's checkpoint could do worse things."""

    def __init__(self, trace) -> None:
        self.trace = trace

    def __reduce__(self):
        return os.mkdir, (str(self.trace),)


def test_no_code_of_a_checkpoint_runs(tmp_path):
    _state().save(tmp_path / "last.pt")
    content = torch.load(tmp_path / "last.pt", weights_only=True)
    torch.save(content | {"config": _Planted(tmp_path / "trace")}, tmp_path / "last.pt")
    with pytest.raises(InputError, match="not a complete checkpoint"):
        _state().load(tmp_path / "last.pt")
    assert not (tmp_path / "trace").exists()


def _torch_file(content) -> bytes:
    file = io.BytesIO()
    torch.save(content, file)
    return file.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"hello",
        _torch_file([1]),
        _torch_file({"step": 3}),
        _torch_file(torch.zeros(4)),
        _torch_file([1])[:200],
    ],
    ids=["empty", "text", "list", "few keys", "tensor", "cut"],
)
def test_a_file_that_is_no_checkpoint_is_named_and_left(tmp_path, content):
    (tmp_path / "last.pt").write_bytes(content)
    with pytest.raises(InputError, match=r"last\.pt: not a complete checkpoint"):
        _state().load(tmp_path / "last.pt")


PARTS = ("network", "optimizer", "average", "step", "best")
OTHERS = "another network or optimiser"


@pytest.mark.parametrize(
    ("wrong", "width", "complaint"),
    [
        ({}, 5, OTHERS),
        *(({part: [None]}, 3, OTHERS) for part in PARTS),
        ({"step": -3}, 3, "it is at step"),
        ({"best": float("nan")}, 3, "best score"),
    ],
)
def test_a_checkpoint_of_something_else_is_refused(tmp_path, wrong, width, complaint):
    _state().save(tmp_path / "last.pt")
    content = torch.load(tmp_path / "last.pt", weights_only=True)
    torch.save(content | wrong, tmp_path / "last.pt")
    with pytest.raises(InputError, match=complaint):
        _state(width).load(tmp_path / "last.pt")


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


def test_trained_weights_are_read_from_the_file_its_folder_or_the_training_s(tmp_path):
    network = torch.nn.Linear(2, 3)
    save_weights(tmp_path / "best" / WEIGHTS, network.state_dict())
    for path in (tmp_path, tmp_path / "best", tmp_path / "best" / WEIGHTS):
        other = torch.nn.Linear(2, 3)
        load_weights(other, path)
        assert torch.equal(other.weight, network.weight)


@pytest.mark.parametrize(
    ("name", "reason"),
    [("none", "no such weights"), ("best", "do not fit this network")],
)
def test_weights_that_are_missing_or_another_network_s_are_an_input_error(
    tmp_path, name, reason
):
    save_weights(tmp_path / "best" / WEIGHTS, torch.nn.Linear(2, 3).state_dict())
    with pytest.raises(InputError, match=reason):
        load_weights(torch.nn.Linear(2, 4), tmp_path / name)
