"""Brings the photos of `elsewhere.json` and `judged.json` from their repositories into FOLDER.

    python benchmarks/outlines.py FOLDER [--clones CLONES]  # from clones OWNER+NAME, if given

Coordinates of `outlines.json`, `elsewhere.json` and `judged.json` are pixels of the stored photo,
whole numbers at the centres of pixels. A pixel belongs to an object where it lies inside an odd
number of its polygons.
"""

import json
import subprocess
import urllib.request
from collections.abc import Iterator
from pathlib import Path

from harness import Row, run_benchmark

ELSEWHERE = [
    Path(__file__).with_name(f"{name}.json") for name in ("elsewhere", "judged")
]
RAW = "https://raw.githubusercontent.com/{repository}/{commit}/{path}"


def fetch(folder: Path, *, clones: Path | None = None) -> Iterator[Row]:
    """Bring the photos of `elsewhere.json` and `judged.json`."""
    listed = [json.loads(file.read_text())["photos"] for file in ELSEWHERE]
    for name, source in (listed[0] | listed[1]).items():
        file = folder / name
        if file.is_file():
            continue
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content(source, clones))
        yield {
            "photo": name,
            "from": source["repository"],
            "licence": source["licence"],
        }


def content(source: dict, clones: Path | None) -> bytes:
    """The photo's bytes, from a clone or from the network."""
    if clones is None:
        with urllib.request.urlopen(RAW.format(**source)) as answer:
            return answer.read()
    clone = clones / source["repository"].replace("/", "+")
    place = f"{source['commit']}:{source['path']}"
    command = ["git", "-C", str(clone), "show", place]
    return subprocess.run(command, check=True, capture_output=True).stdout


if __name__ == "__main__":
    run_benchmark(fetch)
