"""Seconds of wall of a first run after an install: the kernels compiled beside the other steps, or
where they are first needed.

    python benchmarks/first_run.py [--repeats 3]

Every run is the default one, in a process of its own and with an empty cache of compiled code; the
two ways take turns. Measure on a machine that does nothing else.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time

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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3)
    args = parser.parse_args()
    rows = [
        {way: seconds(code) for way, code in WAYS.items()} for _ in range(args.repeats)
    ]
    print("| kernels compiled | seconds of wall, each run | median |")
    print("| --- | --- | --: |")
    for way in WAYS:
        taken = [row[way] for row in rows]
        each = ", ".join(f"{value:.1f}" for value in taken)
        print(f"| {way} | {each} | {statistics.median(taken):.1f} |")


if __name__ == "__main__":
    main()
