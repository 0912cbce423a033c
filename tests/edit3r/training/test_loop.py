"""Signals and the log; what the loop does with a training is tested with the trainers that use it."""

import json
import os
import signal

import pytest

from edit3r.training.loop import Journal, StopRequest


def _steps(path):
    return [json.loads(line)["step"] for line in path.read_text().splitlines()]


def test_lines_are_json_objects(tmp_path):
    journal = Journal(tmp_path)
    journal.write(1, {"loss": 0.5})
    journal.write(2, {"score": 0.25}, kind="validation")
    lines = [json.loads(line) for line in journal.path.read_text().splitlines()]
    assert [line["kind"] for line in lines] == ["train", "validation"]
    assert lines[0]["loss"] == 0.5 and lines[1]["step"] == 2


def test_resuming_takes_out_what_will_be_done_again(tmp_path):
    journal = Journal(tmp_path)
    for step in range(1, 6):
        journal.write(step, {"loss": 0.0})
    journal.path.write_text(journal.path.read_text() + 'no line of ours\n[1]\n{"half a li')
    assert _steps(Journal(tmp_path, step=3).path) == [1, 2, 3]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_noted_and_does_not_interrupt(number):
    with StopRequest() as stop:
        assert not stop.asked
        os.kill(os.getpid(), number)
        assert stop.asked


def test_handlers_are_put_back():
    before = signal.getsignal(signal.SIGINT)
    with StopRequest():
        assert signal.getsignal(signal.SIGINT) is not before
    assert signal.getsignal(signal.SIGINT) is before


def test_a_second_interrupt_stops_at_once():
    # A shell starts background jobs with SIGINT ignored; "as it would have before" is the interrupt only without that.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with StopRequest() as stop, pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            assert stop.asked
            os.kill(os.getpid(), signal.SIGINT)
            signal.sigtimedwait([], 1)
    finally:
        signal.signal(signal.SIGINT, before)
