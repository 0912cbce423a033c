"""Held-out uptake and error of a training against the minutes it took, as a figure; needs
matplotlib.

python benchmarks/training_curve.py runs/edit3r-small-matched --out docs/images/training-curve.png
"""

import argparse
import json
from pathlib import Path


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", type=Path, help="folder of `edit3r train`")
    parser.add_argument(
        "--out", type=Path, default=Path("training-curve.png"), help="the figure"
    )
    args = parser.parse_args()
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    rows = [
        json.loads(line) for line in (args.run / "log.jsonl").read_text().splitlines()
    ]
    rows = [row for row in rows if row["kind"] == "validation"]
    figure, panels = pyplot.subplots(1, 3, figsize=(9, 2.6), layout="constrained")
    for panel, name in zip(panels, ("uptake", "error", "depth")):
        panel.plot(
            [row["seconds"] / 60 for row in rows],
            [row[name] for row in rows],
            "o-",
            markersize=3,
        )
        panel.set(xlabel="minutes", title=name)
        panel.grid(alpha=0.3)
    figure.savefig(args.out, dpi=110)


if __name__ == "__main__":
    main()
