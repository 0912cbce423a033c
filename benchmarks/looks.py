"""How alike do the editor's named looks change what two photos both show?

    python benchmarks/looks.py                             the packaged pair
    python benchmarks/looks.py FOLDER:FIRST,SECOND ...     and photos of folders, by number

A line a look, means over the pairs: how much the photos change (mean absolute difference, sRGB in
[0, 1]), by how much the changes of the same spots differ between the two photos (the disagreement
that `run.json` notes for editors of diffusers), the ratio, and processor seconds for one photo.
`night to winter` stands for views that got different looks: what the measure says of edits that do
not agree at all.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from edit3r_diffusers.consistency import disagreement

import edit3r
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.photos.images import find_photos, packaged_pair

WORST = ("night", "winter")


def measure(views: Views, edited: torch.Tensor, seconds: float) -> list[float]:
    change = float((edited - views.images).abs().mean())
    return [
        change,
        disagreement(views.images[0], edited[0]) or np.nan,
        seconds / views.count,
    ]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("pairs", nargs="*", metavar="FOLDER:FIRST,SECOND")
    parser.add_argument("--size", type=int, default=448)
    options = parser.parse_args()
    pairs = [packaged_pair()[0]]
    for pair in options.pairs:
        folder, _, numbers = pair.rpartition(":")
        photos = find_photos([Path(folder)], 10_000)
        pairs.append([photos[int(number)] for number in numbers.split(",")])
    scenes = [edit3r.load_views(pair, size=options.size) for pair in pairs]
    from edit3r_editors.looks import LOOKS

    editors = {look: edit3r.build("editor", "looks", look=look) for look in LOOKS}
    rows: dict[str, list[list[float]]] = {
        look: [] for look in [*LOOKS, " to ".join(WORST)]
    }
    for views in scenes:
        drawn = {}
        for look, editor in editors.items():
            start = time.process_time()
            drawn[look] = editor.edit(views, EditRequest("")).images
            rows[look].append(measure(views, drawn[look], time.process_time() - start))
        mixed = torch.cat((drawn[WORST[0]][:, :1], drawn[WORST[1]][:, 1:]), 1)
        rows[" to ".join(WORST)].append(measure(views, mixed, 0.0))
    print(
        "| look | change | disagreement | ratio | CPU s |\n| --- | --: | --: | --: | --: |"
    )
    for look, measured in rows.items():
        change, apart, seconds = np.nanmean(measured, 0)
        print(
            f"| {look} | {change:.3f} | {apart:.3f} | {apart / change:.2f} | {seconds:.2f} |"
        )


if __name__ == "__main__":
    main()
