"""What each combination of editor, reconstructor, matcher and segmenter costs that needs no weights
from elsewhere.

    # editors x classical, edit3r; matchers; segmenter
    python benchmarks/combinations.py
    # and single ones, added to those before
    python benchmarks/combinations.py --editors looks --recons refit

Every run is `edit3r run` on the packaged pair at 256 pixels, in a process of its own on one
thread. Results go into `benchmarks/combinations.json`, from which `python docs/generate.py` makes
the tables of docs/combinations.md: CPU seconds of the edit and of all else, peak memory of the
process, the run's verdict, or the sentence that it ended with. Weights that are at hand are used
and noted.
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
from edit3r_select.select import select_masks

import edit3r
from edit3r.contract.interfaces import Selection
from edit3r.kit.photos.images import packaged_pair
from edit3r.kit.weights.find import at_hand

RESULTS = Path(__file__).with_suffix(".json")
MASK = Path(edit3r.__file__).parent / "kit/photos/motorcycle_mask.png"
SIZE = 256
ASKED = {
    "none": [],
    "recolor": ["--prompt", "paint the motorcycle blue"],
    "looks": ["--prompt", "make it look like autumn"],
    "mock-diffusion": ["--prompt", "make it rusty"],
    "retouch": ["--mask", str(MASK)],
}
MATCHERS = {"classical (matches=learned)": "{name: classical, matches: learned}"}
CLICK = (0.45, 0.55)


def run(editor: str, recon: str, matcher: str = "classical") -> dict:
    """One run by the command, in a process of its own."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    row = {"editor": editor, "recon": recon, "matcher": matcher}
    chosen = ["--set", f"matcher={MATCHERS[matcher]}"] if matcher in MATCHERS else []
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            "-m",
            "edit3r",
            "run",
            "--editor",
            editor,
            "--recon",
            recon,
            "--size",
            str(SIZE),
        ]
        command += [
            *ASKED[editor],
            *chosen,
            "--frames",
            "2",
            "--outputs",
            "sheet",
            "--quiet",
            "--out",
            folder + "/out",
        ]
        done = subprocess.run(
            command, capture_output=True, text=True, env=environment, check=False
        )
        if done.returncode:
            return {**row, "error": done.stderr.strip().splitlines()[-1]}
        made = json.loads(Path(folder, "out", "run.json").read_text())
    seconds = {stage["name"]: stage["cpu_seconds"] for stage in made["stages"]}
    edit = sum(value for name, value in seconds.items() if name.startswith("edit"))
    rest = sum(seconds.values()) - edit
    peak = max(stage["peak_memory_mb"] for stage in made["stages"])
    return {
        **row,
        "edit": round(edit, 1),
        "rest": round(rest, 1),
        "mb": round(peak),
        "verdict": made["verdict"]["label"],
    }


def segment(name: str) -> dict:
    """Masks of both photos from one click."""
    views = edit3r.load_views(packaged_pair()[0], size=SIZE)
    segmenter = edit3r.build("segmenter", name)
    start = time.process_time()
    with torch.no_grad():
        select_masks(views.images[0], Selection(positive=((0, *CLICK),)), segmenter)
    return {"segmenter": name, "seconds": round(time.process_time() - start, 1)}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--editors", nargs="+")
    parser.add_argument("--recons", nargs="+")
    options = parser.parse_args()
    made = [
        run(e, r)
        for e in options.editors or ASKED
        for r in options.recons or ("classical", "edit3r")
    ]
    if not (options.editors or options.recons):
        made += [
            run("none", recon, matcher)
            for matcher in MATCHERS
            for recon in ("classical", "edit3r")
        ]
        made.append(segment("classical"))
    rows = json.loads(RESULTS.read_text())["rows"] if RESULTS.exists() else []
    keys = ("editor", "recon", "matcher", "segmenter")
    kept = {tuple(row.get(key) for key in keys): row for row in [*rows, *made]}
    components = [offer.component for kind in ("editor", "reconstructor", "segmenter", "matcher")
                  for offer in edit3r.components(kind)]  # fmt: skip
    real = sorted(
        {
            one.name
            for component in components
            for one in component.weights
            if at_hand(one)
        }
    )
    result = {"size": SIZE, "weights_at_hand": real, "rows": list(kept.values())}
    RESULTS.write_text(json.dumps(result, indent=1) + "\n")
    for row in made:
        print(row)


if __name__ == "__main__":
    main()
