"""The resumable runner: each row once, whole, and in order, however often it was interrupted."""

import math
import os
from concurrent.futures import Future, ThreadPoolExecutor, wait

import pytest

from edit3r.contract.errors import InputError, RunError
from edit3r.kit.worker_pool import InProcesses, Task, WorkerDied
from edit3r.kit.workers import (
    Workers,
    _Shift,
    append_row,
    read_rows,
    repair,
    run_resumable,
)

JOBS = {"a": {"value": 1}, "b": {"value": 2}, "c": {"value": 3}}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "rows.jsonl"


def test_rows_come_back_in_order_and_are_made_once(path):
    told = []
    rows = run_resumable(JOBS, dict, path, on_done=told.append)
    assert rows["b"] == {"key": "b", "value": 2} and list(rows) == ["a", "b", "c"]
    assert [(p.key, p.done, p.total) for p in told] == [
        ("a", 1, 3),
        ("b", 2, 3),
        ("c", 3, 3),
    ]
    assert told[-1].seconds_left == 0
    before = path.read_bytes()
    assert run_resumable(JOBS, lambda job: pytest.fail("done again"), path) == rows
    assert path.read_bytes() == before


def test_an_interrupted_run_goes_on_and_leaves_the_file_of_a_straight_one(
    path, tmp_path
):
    def stops(job):
        if job["value"] == 2:
            raise KeyboardInterrupt
        return job

    with pytest.raises(KeyboardInterrupt):
        run_resumable({name: JOBS[name] for name in "cba"}, stops, path)
    assert set(read_rows(path)) == {"c"}
    run_resumable(JOBS, dict, path)
    run_resumable(JOBS, dict, tmp_path / "straight.jsonl")
    assert path.read_bytes() == (tmp_path / "straight.jsonl").read_bytes()


@pytest.mark.slow
def test_processes_give_the_same_rows(path, tmp_path):
    rows = run_resumable(JOBS, dict, path, workers=Workers(2, threads=1))
    assert rows == run_resumable(JOBS, dict, tmp_path / "one.jsonl")


def dies_of_two(job):
    if job["value"] == 2:
        os._exit(9)
    return {**job, "process": os.getpid()}


@pytest.mark.slow
def test_a_worker_that_dies_is_the_row_of_its_job_alone_where_it_may(path):
    with pytest.raises(RunError, match=r"worker process died.*What is done is kept"):
        run_resumable(JOBS, dies_of_two, path, workers=Workers(2))
    for count in (1, 2):
        own = path.with_name(f"{count}.jsonl")
        rows = run_resumable(
            JOBS, dies_of_two, own, workers=Workers(count, may_die=True)
        )
        assert list(rows) == list("abc") and set(rows["b"]) == {"key", "failure"}
        assert all(
            "process" in rows[key] and rows[key]["process"] != os.getpid()
            for key in "ac"
        )


class Mortal:
    """A pool without processes, whose workers die of job b."""

    def __init__(self, tries):
        self.tries, self.given = tries, []

    def start(self):
        return object(), None

    def give(self, worker, job):
        self.given.append(job[0])
        return job[0]

    def first(self, tickets, any_ready):
        return tickets[0]

    def answer(self, ticket):
        if ticket == "b":
            raise WorkerDied
        return ticket, JOBS[ticket]


@pytest.mark.parametrize("may_die", [True, False])
@pytest.mark.parametrize("tries", [1, 2])
def test_a_job_of_which_workers_die_is_tried_so_often_and_alike_jobs_follow_each_other(
    tries, may_die
):
    pool, rows = Mortal(tries), []
    shift = _Shift(
        pool, JOBS.items(), Workers(1, may_die=may_die), lambda job: job["value"] % 2
    )
    try:
        while shift.hand_out():
            rows.append(shift.next_row())
    except RunError as error:
        assert not may_die and "What is done is kept" in str(error)
        rows.append(("b", None))
    assert pool.given == ["a", "c"] + ["b"] * tries
    assert [row[0] for row in rows if row] == ["a", "c", "b"]


def test_an_answer_is_taken_while_another_is_waited_for():
    done, waiting = Future(), Future()
    done.set_result(None)
    with ThreadPoolExecutor(1) as asker:
        first = asker.submit(InProcesses(Task(dict, None)).first, [waiting, done], True)
        finished = wait([first], timeout=10).done
        waiting.set_result(None)  # ends a pool that waits for all
    assert finished and first.result() is done


def test_rows_of_other_jobs_stay(path):
    run_resumable(JOBS, dict, path)
    assert list(run_resumable({"d": {}, "a": {}}, dict, path)) == ["d", "a"]
    assert list(read_rows(path)) == ["d", "a", "b", "c"]


def test_an_error_ends_the_run(path):
    def fails(job):
        raise RunError("no memory.")

    with pytest.raises(RunError):
        run_resumable(JOBS, fails, path)


def test_numbers_that_json_lacks_are_null_at_once_and_when_read(path):
    rows = run_resumable(
        {"a": {"psnr": math.inf, "more": [math.nan, 1.5]}}, dict, path, key_name="id"
    )
    assert (
        rows
        == {"a": {"id": "a", "psnr": None, "more": [None, 1.5]}}
        == read_rows(path, "id")
    )


def test_a_line_cut_at_any_byte_counts_as_never_written(path):
    append_row(path, {"key": "a", "text": "ä"})
    size = os.path.getsize(path)
    append_row(path, {"key": "b", "text": "ö"})
    content = path.read_bytes()
    for end in range(size, len(content)):
        path.write_bytes(content[:end])
        repair(path)
        assert set(read_rows(path)) == {"a"} and path.read_bytes() == content[:size]


def test_a_bad_line_is_named(path):
    path.write_text('{"key": "a"}\n{"kex": 1}\n')
    with pytest.raises(InputError, match="line 2: not a result"):
        read_rows(path)
