import subprocess
import sys

import psutil
import pytest

from edit3r.contract.reporting import available_memory, peak_memory_mb


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


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell")
def test_memory_that_is_free_is_told_in_bytes():
    assert 0.5 < available_memory() / psutil.virtual_memory().available < 2
