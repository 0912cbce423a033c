"""Does the same seed give the same bytes? Runs the stages in many fresh processes with different
numbers of threads.

    python benchmarks/same_bytes.py --processes 200

A fresh process matters: what differs is often only the first call of a library in it. Prints one
line per stage: how many different answers there were. Exit code 1 where there was more than one.
"""

import argparse
import collections
import json
import os
import subprocess
import sys

THREADS = (1, 2, 4, 16)

STAGES = """
import hashlib, json, sys
import torch
import edit3r
from edit3r.io.images import load_views, packaged_pair
from edit3r.selection.select import Selection

def digest(*tensors):
    content = b"".join(tensor.contiguous().numpy().tobytes() for tensor in tensors)
    return hashlib.sha256(content).hexdigest()[:16]

torch.set_num_threads(int(sys.argv[1]))
photos, cameras = packaged_pair()
views = load_views(photos, cameras=cameras, size=int(sys.argv[2]))
marked = Selection(positive=((0, 0.5, 0.55),))
result = edit3r.run(views, "paint it blue", masks=marked)
gaussians = result.gaussians
fields = ("means", "scales", "quats", "opacities", "harmonics")
print(json.dumps({
    "photos": digest(views.images), "edit": digest(result.edited.images),
    "poses": digest(result.cameras.c2w),
    "gaussians": digest(*(getattr(gaussians, field) for field in fields)),
    "render": digest(result.rendered.images),
}))
"""


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--processes", type=int, default=200)
    parser.add_argument(
        "--size", type=int, default=96, help="longest side of the photos [pixels]"
    )
    options = parser.parse_args()
    answers: dict[str, collections.Counter] = collections.defaultdict(
        collections.Counter
    )
    for index in range(options.processes):
        threads = str(THREADS[index % len(THREADS)])
        environment = {
            **os.environ,
            "OMP_NUM_THREADS": threads,
            "NUMBA_NUM_THREADS": threads,
        }
        command = [sys.executable, "-c", STAGES, threads, str(options.size)]
        printed = subprocess.run(
            command, env=environment, stdout=subprocess.PIPE, check=True
        ).stdout
        for stage, found in json.loads(printed).items():
            answers[stage][found] += 1
    for stage, found in answers.items():
        print(
            f"{stage:10} {len(found)} different in {options.processes} processes "
            f"{list(found.values())}"
        )
    return int(any(len(found) > 1 for found in answers.values()))


if __name__ == "__main__":
    sys.exit(main())
