"""Fetches the photos whose outlines are in `elsewhere.json`: photos of public repositories, which
are not part of this one.

    python benchmarks/elsewhere.py FOLDER [--clones CLONES]
    python benchmarks/clicks.py FOLDER --objects benchmarks/elsewhere.json

Each photo has its repository, path, commit and licence there. With --clones they come from local
clones CLONES/owner+name instead of the network. An object says how it was outlined, whether it is a
part of something else, and whether it is never fitted on: eight whole scenes, judged last.
"""

import argparse
import json
import subprocess
import urllib.request
from pathlib import Path

FILE = Path(__file__).with_suffix(".json")
RAW = "https://raw.githubusercontent.com/{repository}/{commit}/{path}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="where the photos go")
    parser.add_argument("--clones", type=Path, help="folder of clones, owner+name")
    args = parser.parse_args()
    for name, source in json.loads(FILE.read_text())["photos"].items():
        file = args.folder / name
        if file.is_file():
            continue
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content(source, args.clones))
        print(f"{name}: {source['repository']}, {source['licence']}")


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
    main()
