"""Two gloo processes on a CPU, started as torchrun does, but as forks, which import nothing."""

import runpy
from pathlib import Path

import pytest
import torch
from edit3r_training.checkpoint import LAST

from edit3r_testing.training import tiny_job

from .training_kit import log_of

pytestmark = pytest.mark.slow

SCRIPT = Path(__file__).with_name("two_processes.py")
STEPS, trainer, main = (
    runpy.run_path(str(SCRIPT))[name] for name in ("STEPS", "trainer", "main")
)


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """A training in this process, and the weights that it began with."""
    job = tiny_job(tmp_path_factory.mktemp("alone"))
    state = job.reconstructor.network.state_dict()
    start = {name: tensor.clone() for name, tensor in state.items()}
    trainer(batch=2).train(job)
    return job, start


@pytest.fixture(scope="module")
def run(tmp_path_factory, alone) -> Path:
    """The folder of both; after `alone`, for what training imports the forks find imported."""
    from torch.distributed.launcher.api import LaunchConfig, elastic_launch

    out = tmp_path_factory.mktemp("two")
    config = LaunchConfig(
        min_nodes=1,
        max_nodes=1,
        nproc_per_node=2,
        rdzv_backend="c10d",
        rdzv_endpoint="127.0.0.1:0",
        max_restarts=0,
        monitor_interval=0.1,
        start_method="fork",
    )
    elastic_launch(config, main)(out)
    return out


def _weights(folder: Path, name: str) -> list[dict]:
    return [torch.load(folder / f"{name}-{rank}.pt") for rank in (0, 1)]


def test_two_processes_with_half_batches_give_one_process_s_weights(run, alone):
    job, start = alone
    for mine in _weights(run / "straight", "weights"):
        for name, expected in job.reconstructor.network.state_dict().items():
            assert torch.allclose(mine[name], expected, atol=1e-5), name
            assert not torch.allclose(start[name], expected, atol=1e-3), name
    together, single = log_of(run / "straight"), log_of(job.out)
    # metrics are those of the whole batch
    for one, other in zip(together, single, strict=True):
        assert one["kind"] == other["kind"] and one["step"] == other["step"]
        names = ("loss", "norm") if one["kind"] == "train" else ("colour", "depth")
        assert all(abs(one[name] - other[name]) < 1e-4 for name in names), (one, other)


def test_one_process_writes(run):
    straight = run / "straight"
    steps = [line["step"] for line in log_of(straight) if line["kind"] == "train"]
    assert steps == list(range(1, STEPS + 1))
    assert (straight / "best" / "weights.safetensors").is_file()
    assert torch.load(straight / LAST, weights_only=True)["step"] == STEPS


def test_a_signal_to_one_process_stops_all_and_resuming_gives_the_straight_run_s_weights(
    run,
):
    half = _weights(run / "stopped", "half")
    straight = _weights(run / "straight", "weights")
    resumed = _weights(run / "stopped", "weights")
    for name, expected in straight[0].items():
        assert torch.equal(half[0][name], half[1][name])
        assert not torch.equal(half[0][name], expected)
        assert all(torch.equal(one[name], expected) for one in resumed)


def test_nothing_of_the_group_outlives_the_training(run):
    """Its threads would run into the end of Python, which aborts the process now and then."""
    left = [(run / f"group-{rank}.txt").read_text() for rank in (0, 1)]
    assert left == ["gone", "gone"]
