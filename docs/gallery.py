"""A page of edited scenes that move, each with its command, its verdicts and its viewer.

    python docs/gallery.py OUT [--only NAME ...]          OUT/index.html is the page
    python docs/gallery.py docs/scenes --pages            for docs/scenes.md: viewers alone

All are made from photos that ship. The moving images of the README are from here.
"""

import argparse
import html
import json
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
from PIL import Image

ROOT = Path(__file__).parents[1]
OPERA = tuple(f"plugins/edit3r_app/made/opera_house_{number}.jpg" for number in (1, 2))
WIDTH = 320  # of a moving image [pixels]
MILLISECONDS = 70  # of one of its frames
PAGE = """<!doctype html><meta charset="utf-8"><title>edit3r: edited scenes</title>
<meta name="viewport" content="width=device-width">
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 84rem }}
body {{ padding: 0 1rem }}
main {{ display: grid; gap: 2rem }}
main {{ grid-template-columns: repeat(auto-fill, minmax(20rem, 1fr)) }}
img {{ width: 100%; border-radius: 6px }}
code {{ font-size: 12px; overflow-wrap: anywhere }}
p {{ margin: .3rem 0 }}
</style>
<h1>Edited scenes</h1>
<p>Each was made of the photos named in its command, on a CPU, and is shown as it came out.</p>
<main>{cards}</main>
"""
CARD = """<article><a href="{name}/viewer.html"><img src="{name}.webp" alt="{prompt}"></a>
<h2>{prompt}</h2><p>selected: {selected}, edit: {edit}, scene: {scene}.
<a href="{name}/viewer.html">Walk around</a>.</p>
<p><code>{command}</code></p></article>"""


@dataclass(frozen=True)
class Edit:
    """What one scene of the page shows."""

    name: str
    prompt: str
    photos: tuple[str, ...] = ()  # none: the pair that ships
    more: str = ""  # other words of the command
    on_site: bool = True  # False: it takes learned weights to be good

    @property
    def command(self) -> list[str]:
        words = ["edit3r", "run", *self.photos, "--prompt", self.prompt]
        return words + self.more.split()


EDITS = (
    Edit("blue", "paint the motorcycle blue"),
    Edit("gold", "paint the tank gold", more="--point 0.55,0.41", on_site=False),
    Edit("only-red", "everything but the motorcycle in black and white"),
    Edit("night", "make it night"),
    Edit("sepia", "make it sepia"),
    Edit("pink-sky", "paint the sky pink", OPERA),
    Edit("opera-night", "make it night", OPERA),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", nargs="*", default=[], help="names of scenes")
    parser.add_argument(
        "--pages", action="store_true", help="leave viewers, and what is said of each"
    )
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    shown = []
    for edit in EDITS:
        if (args.only and edit.name not in args.only) or (
            args.pages and not edit.on_site
        ):
            continue
        shown.append(made(edit, args.out.resolve() / edit.name, args.pages))
        if args.pages:
            text = json.dumps(shown, indent=1)
            (args.out / "scenes.json").write_text(text + "\n", encoding="utf-8")
        else:
            cards = (
                CARD.format(**{key: html.escape(text) for key, text in one.items()})
                for one in shown
            )
            (args.out / "index.html").write_text(PAGE.format(cards="\n".join(cards)))
        print("{name}: edit {edit}, scene {scene}".format(**shown[-1]))


def made(edit: Edit, folder: Path, page_alone: bool) -> dict[str, str]:
    """Run an edit; what its card says. The folder of the run stays, or its viewer beside it."""
    shutil.rmtree(folder, ignore_errors=True)
    command = [sys.executable, "-m", *edit.command, "--out", str(folder), "--quiet"]
    subprocess.run(command, cwd=ROOT, check=True)
    run = json.loads((folder / "run.json").read_text())
    if page_alone:
        shutil.move(folder / "viewer.html", folder.with_suffix(".html"))
        shutil.rmtree(folder)
    else:
        moving_image(folder / "video.webm", folder.with_suffix(".webp"))
    return {
        "name": edit.name,
        "prompt": edit.prompt,
        "selected": (run["selection_verdict"] or {"label": "all of it"})["label"],
        "edit": run["edit_verdict"]["label"],
        "scene": run["verdict"]["label"],
        "command": shlex.join(edit.command),
    }


def moving_image(video: Path, path: Path) -> None:
    """Turn a video into an animated WebP that plays for ever."""
    reader = cv2.VideoCapture(str(video))
    frames = []
    while (answer := reader.read())[0]:
        image = Image.fromarray(cv2.cvtColor(answer[1], cv2.COLOR_BGR2RGB))
        height = round(image.height * WIDTH / image.width)
        frames.append(image.resize((WIDTH, height), Image.Resampling.LANCZOS))
    rest = {"append_images": frames[1:], "duration": MILLISECONDS, "loop": 0}
    frames[0].save(path, save_all=True, quality=50, method=6, **rest)


if __name__ == "__main__":
    main()
