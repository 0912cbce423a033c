import subprocess
import sys

import pytest

from edit3r.contract.reporting import (
    Report,
    collecting,
    note,
    peak_memory_mb,
    progress,
    track,
    warn,
)


def test_calls_outside_a_run_do_nothing():
    note("a", 1)
    warn("b")
    assert list(track([1, 2], "c")) == [1, 2]


def test_notes_and_warnings_reach_the_report_and_a_warning_is_said_once():
    report = Report()
    with collecting(report):
        note("editor.steps", 3)
        warn("careful")
        warn("careful")
    assert report.notes == {"editor.steps": 3} and report.warnings == ["careful"]


def test_progress_is_told_as_it_happens():
    events = []
    report = Report(on_event=lambda *event: events.append(event))
    with collecting(report):
        for _ in track("ab", "letters"):
            pass
        progress("more", 1, 2)
    assert events == [("progress", "letters", n, 2) for n in range(3)] + [
        ("progress", "more", 1, 2)
    ]


def test_a_stage_that_raises_is_not_recorded():
    report = Report()
    with pytest.raises(KeyError), report.stage("bad"):
        raise KeyError
    with report.stage("good"):
        pass
    assert [stage.name for stage in report.stages] == ["good"]


def test_peak_memory_is_this_process_own():
    """A child of a large process starts small."""
    ballast = bytearray(300 * 2**20)
    ballast[::4096] = b"x" * len(ballast[::4096])
    code = (
        "from edit3r.contract.reporting import peak_memory_mb; print(peak_memory_mb())"
    )
    told = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert 5 < float(told) < 300 < peak_memory_mb()
