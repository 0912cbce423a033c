import pytest

from edit3r.contract.reporting import Report, collecting, note, progress, track, warn


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
