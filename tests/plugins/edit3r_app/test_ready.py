"""A process that waits for its arguments carries out the command, and ends with the server."""

import sys
import time

from edit3r_app.ready import begin, waiting

WAITS = (
    sys.executable,
    "-c",
    "import time; from edit3r_app.ready import take; told = take();"
    "print(len(told), told[0], flush=True); time.sleep(60)",
)


def test_it_writes_into_the_file_until_the_server_ends(tmp_path):
    log = tmp_path / "log"
    process = waiting(WAITS)
    # more than one portion: sixty photos in a deep folder
    begin(process, ["x" * 100_000, "photo"], log)
    end = time.monotonic() + 30
    while not (log.is_file() and log.read_bytes()) and time.monotonic() < end:
        time.sleep(0.02)
    assert log.read_text().startswith("2 xxx")
    assert process.poll() is None
    process.stdin.close()  # as the end of the server does
    assert process.wait(30) != 0


def test_one_that_waits_ends_with_the_server():
    process = waiting(WAITS)
    process.stdin.close()
    assert process.wait(30) == 0
