"""Edit a splat: python examples/edit_splat.py SCAN SENTENCE OUT [VIEW,X,Y]."""

import sys

import edit3r


def edit(scan: str, sentence: str, out: str, click: str = "", **settings) -> int:
    """Write the edited scene, and return how many of its Gaussians have other colours.

    `click` is a picture, from 1, and a place on it [shares of its sides]; `edit3r run SCAN
    --preview` shows the pictures.
    """
    marks = None
    if click:
        view, x, y = click.split(",")
        marks = edit3r.Selection(positive=((int(view) - 1, float(x), float(y)),))
    result = edit3r.run(scan, sentence, masks=marks, **settings)
    result.save(out)
    return int(result.report.notes.get("scene.changed", {}).get("gaussians", 0))


if __name__ == "__main__":
    if len(sys.argv) not in (4, 5):
        sys.exit(__doc__)
    print(f"{edit(*sys.argv[1:]):,} Gaussians have other colours")
