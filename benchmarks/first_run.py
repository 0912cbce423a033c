"""Seconds of wall of a first run after an install: the kernels compiled beside the other steps, or
where they are first needed.

    python benchmarks/first_run.py [--repeats 3]

Every run is the default one, in a process of its own and with an empty cache of compiled code; the
two ways take turns. Measure on a machine that does nothing else.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator

from harness import Row, run_benchmark

WAYS = {
    "beside": "",
    "when needed": "from edit3r_rasterizers.numba_rasterizer import NumbaRasterizer\n"
    "NumbaRasterizer.prepare = lambda rasterizer, device: None\n",
}
RUN = "import sys\nfrom edit3r.cli.main import main\nsys.exit(main(sys.argv[1:]))\n"


def seconds(preparation: str) -> float:
    """How long the default run takes."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": f"{folder}/cache"}
        command = [sys.executable, "-c", preparation + RUN, "run", "--quiet"]
        start = time.perf_counter()
        subprocess.run(
            [*command, "--out", f"{folder}/out"], env=environment, check=True
        )
        return time.perf_counter() - start


def main(*, repeats: int = 3) -> Iterator[Row]:
    rows = [{way: seconds(code) for way, code in WAYS.items()} for _ in range(repeats)]
    for way in WAYS:
        taken = [row[way] for row in rows]
        yield {
            "kernels compiled": way,
            "seconds of wall, each run": ", ".join(f"{value:.1f}" for value in taken),
            "median": (statistics.median(taken), ".1f"),
        }


if __name__ == "__main__":
    run_benchmark(main)
