"""What a whole run of the paper's full network costs: `edit3r run` with random weights of the
published layout, photos in, folder out: nothing edited, and an edit that must stay in its masks,
for which the scene before the edit is made too.

    python benchmarks/full_run.py [--precision float32 bfloat16] [--folder FOLDER]

The weights (2.4 GB) are written to a temporary folder in FOLDER and removed. The photos are the
packaged pair at 256x352. Prints CPU seconds of the whole process and the most memory it held.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import torch
from PIL import Image

from edit3r.kit.photos.images import packaged_pair

ROOT = Path(__file__).parents[1]
MASKS = sorted((ROOT / "edit3r/kit/photos").glob("motorcycle_mask*.png"))
sys.path.insert(0, str(ROOT / "tests/plugins/edit3r_model"))
from noposplat_reference import FULL, random_state  # noqa: E402  (shares no code with the plugin)

HEIGHT, WIDTH = 256, 352
RESOLUTION = 301  # squared just above HEIGHT * WIDTH: nothing is scaled


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--precision", nargs="+", default=["float32", "auto"])
    parser.add_argument("--folder", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=args.folder) as name:
        folder = Path(name)
        state = random_state(FULL, seed=0)
        content = {f"encoder.{key}": value for key, value in state.items()}
        torch.save({"epoch": 0, "state_dict": content}, folder / "full.ckpt")
        del state, content
        photos = [small(file, folder) for file in packaged_pair()[0]]
        masks = [small(file, folder) for file in MASKS]
        edits = {
            "none": ["--editor", "none"],
            "blue motorcycle": ["--prompt", "paint it blue", "--mask", *masks],
        }
        print("| precision | edit | CPU s | of it network | wall s | peak memory |")
        print("| --- | --- | --: | --: | --: | --: |")
        for precision in args.precision:
            for name, options in edits.items():
                figures = cost(folder, precision, [*photos, *options])
                print(f"| `{precision}` | {name} | {figures} |", flush=True)


def small(file: str | Path, folder: Path) -> Path:
    """The image in the size of the benchmark."""
    target = folder / f"{Path(file).stem}.png"
    Image.open(file).resize((WIDTH, HEIGHT)).save(target)
    return target


def cost(folder: Path, precision: str, run: list[str | Path]) -> str:
    """CPU seconds of one run and of the network in it, wall seconds and memory, as cells."""
    settings = {
        "weights": folder / "full.ckpt",
        "resolution": RESOLUTION,
        "precision": precision,
    }
    options = [
        f"--set=reconstructor.{name}={value}" for name, value in settings.items()
    ]
    out = folder / precision
    command = [sys.executable, "-m", "edit3r", "run", *run, *options]
    process = subprocess.Popen(
        [*command, "--quiet", "--overwrite", "--out", out],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    start = time.monotonic()
    _, status, used = os.wait4(process.pid, 0)
    wall = time.monotonic() - start
    if status:
        raise SystemExit(f"the run ended with {os.waitstatus_to_exitcode(status)}")
    stages = json.loads((out / "run.json").read_text())["stages"]
    network = sum(
        stage["cpu_seconds"] for stage in stages if "reconstruct" in stage["name"]
    )
    return (
        f"{used.ru_utime + used.ru_stime:.1f} | {network:.1f} | {wall:.0f} | "
        f"{used.ru_maxrss / 1024:.0f} MiB"
    )


if __name__ == "__main__":
    main()
