"""A process that waits for its arguments is the same to its job as one that is started for it."""

import sys
import time

import pytest
from edit3r_app.ready import CAN_WAIT, ReadyProcess
from edit3r_app.runner import _locked

pytestmark = pytest.mark.skipif(not CAN_WAIT, reason="Windows sends no files")
WAITS = (
    sys.executable,
    "-c",
    "import sys, time; from edit3r_app.ready import take; told = take(int(sys.argv[1]));"
    "told is None or print(len(told), told[0], flush=True); told is None or time.sleep(60)",
)


def test_it_writes_into_the_file_and_holds_its_lock_as_long_as_it_lives(tmp_path):
    log = tmp_path / "log"
    ready = ReadyProcess(WAITS)
    with log.open("ab") as output:
        assert _locked(output)
        # more than one portion: sixty photos in a deep folder
        child = ready.begin(["x" * 100_000, "photo"], output)
    try:
        assert child is ready.process
        end = time.monotonic() + 30
        while not log.read_bytes() and time.monotonic() < end:
            time.sleep(0.02)
        assert log.read_text().startswith("2 xxx")
        with log.open("rb") as output:
            assert not _locked(output)
    finally:
        child.kill()
        child.wait()
    with log.open("rb") as output:
        assert _locked(output)


def test_it_ends_with_the_server_and_is_not_used_when_it_ended(tmp_path):
    ready = ReadyProcess(WAITS)
    ready._asks.close()  # as the end of the server does
    assert ready.process.wait(30) == 0
    gone = ReadyProcess((sys.executable, "-c", ""))
    gone.process.wait()
    with (tmp_path / "log").open("ab") as output:
        assert gone.begin(["run"], output) is None
