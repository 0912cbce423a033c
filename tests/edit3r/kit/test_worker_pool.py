"""Workers on a Ray cluster: no more at once than fit, each job one row, though a node dies."""

import os
import time
from collections import Counter, defaultdict

import pytest

from edit3r.contract.errors import InputError, RunError
from edit3r.kit import worker_pool
from edit3r.kit.workers import Workers, read_rows, run_resumable

pytestmark = pytest.mark.slow

NODE = {"num_cpus": 8, "num_gpus": 1}


@pytest.fixture(scope="module")
def cluster():
    """A cluster on this machine, of one node with a GPU; the tests' workers find it."""
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        head = {**NODE, "include_dashboard": False}
        cluster = Cluster(initialize_head=True, head_node_args=head)
        patch.setenv("RAY_ADDRESS", cluster.address)
        yield cluster
        ray.shutdown()
        cluster.shutdown()


def logs_itself(job):
    """A job that takes a while; when it began and ended is in a file of its own."""
    from pathlib import Path

    begin = time.time()
    time.sleep(job["seconds"])
    seen = os.environ.get("CUDA_VISIBLE_DEVICES", "")
    name = f"{job['name']}-{begin}"
    (Path(job["log"]) / name).write_text(f"{begin} {time.time()} {os.getpid()}")
    return {"gpus": seen}


def jobs_of(log, count, seconds=0.3):
    return {
        f"j{n}": {"name": f"j{n}", "seconds": seconds, "log": str(log)}
        for n in range(count)
    }


def most_at_once(log):
    """How many of the logged jobs went on at one time."""
    spans = [tuple(map(float, f.read_text().split()[:2])) for f in log.iterdir()]
    return max(sum(b <= begin < e for b, e in spans) for begin, _ in spans)


def test_shares_of_gpus_bound_the_workers_and_a_dead_node_loses_no_row(
    tmp_path, cluster
):
    second = cluster.add_node(**NODE)
    log = tmp_path / "log"
    log.mkdir()
    path, jobs = tmp_path / "rows.jsonl", jobs_of(log, 16, 0.5)
    asked = Workers(40, "ray", gpus=0.5, may_die=True)

    def kill_once(progress):
        if progress.done == 6:
            cluster.remove_node(second, allow_graceful=False)

    rows = run_resumable(jobs, logs_itself, path, workers=asked, on_done=kill_once)
    assert list(rows) == list(jobs) and list(read_rows(path)) == list(jobs)
    assert all(row.keys() == {"key", "gpus"} for row in rows.values())
    assert {row["gpus"] for row in rows.values()} == {"0"}
    assert 2 <= most_at_once(log) <= 4
    done = Counter(file.name.partition("-")[0] for file in log.iterdir())
    assert len(done) == len(jobs)
    # only what the dead node's two workers had finished, and not told, is done again
    assert sum(done.values()) <= len(jobs) + 2


def fails(job):
    raise InputError("no such photo.")


def dies(job):
    os._exit(9)


def test_a_cluster_without_room_an_error_and_a_job_that_kills_twice_are_told(
    tmp_path, cluster, monkeypatch
):
    jobs = jobs_of(tmp_path, 1)
    asked = Workers(2, "ray", may_die=True)
    too_large = Workers(2, "ray", gpus=8, memory=10**6)  # of the node's one
    with (
        monkeypatch.context() as patch,
        pytest.raises(RunError, match=r"'num_gpus': 8.*--gpus-per-worker"),
    ):
        patch.setattr(worker_pool, "MOST_WAIT", 3)
        run_resumable(jobs, logs_itself, tmp_path / "r", workers=too_large)
    with pytest.raises(InputError, match="no such photo"):
        run_resumable(jobs, fails, tmp_path / "one", workers=asked)
    rows = run_resumable(jobs, dies, tmp_path / "two", workers=asked)
    assert "worker process died" in rows["j0"]["failure"]


def test_a_worker_does_all_of_a_group_before_another_one(tmp_path, forked_workers):
    """A worker that starts late is helped: two may do jobs of one group."""
    jobs = {
        f"{n}": {"name": name, "seconds": 0.2, "log": str(tmp_path)}
        for n, name in enumerate("aabbaabb")
    }
    run_resumable(
        jobs,
        logs_itself,
        tmp_path.parent / "rows",
        workers=Workers(2),
        group=lambda job: job["name"],
    )
    done = defaultdict(str)
    for file in sorted(tmp_path.iterdir(), key=lambda file: file.name[2:]):
        done[file.read_text().split()[2]] += file.name[0]
    assert sorted("".join(done.values())) == sorted("aabbaabb")
    changes = [groups.count("ab") + groups.count("ba") for groups in done.values()]
    assert max(changes) <= 1
