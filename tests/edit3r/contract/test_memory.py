import subprocess
import sys

from edit3r.contract.reporting import peak_memory_mb


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
