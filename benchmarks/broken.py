"""Does the verdict know a broken reconstructor, and a sound one?

    python benchmarks/broken.py FOLDER... --keep FOLDER --rows ROWS.jsonl
    python benchmarks/fit_verdict.py ROWS.jsonl

Each folder holds photos, or an images/ with them, and is a place. Two pairs of each, and three
photos where there are twelve, are reconstructed from their photos alone at 256 pixels: by the
default, by one Gaussian of each pixel of the run's geometry, and by the same broken in each way of
`edit3r_testing.broken`. With --keep what the critic is shown stays in FOLDER, and is judged anew in
seconds. A row says the set's place, kind and strength, the figures and the verdict.
"""

import functools
import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from edit3r_judge.critic import LimitsCritic
from harness import run_benchmark

import edit3r
from edit3r.contract.errors import Edit3rError
from edit3r.contract.interfaces import Geometry, Matcher, SceneToJudge
from edit3r.kit.rendering import render_each
from edit3r.running.steps.judge import seen_half_way
from edit3r_testing.broken import KINDS, BrokenReconstructor

SIZE = 256
PHOTOS = (".jpg", ".jpeg", ".png")
PLAIN = {"gaussians": "all", "refine": 0, "refiners": (), "outputs": []}


class Keeps(LimitsCritic):
    """Keeps what it is asked about."""

    scene: SceneToJudge

    def judge_scene(self, scene):
        self.scene = scene
        return super().judge_scene(scene)


class Known(Matcher):
    """Answers with what another matcher read before."""

    def __init__(self, geometry: Geometry) -> None:
        super().__init__(None)
        self.geometry = geometry

    def match(self, views):
        return self.geometry


def sets_of(folder: Path) -> list[list[Path]]:
    """The photos of each set of a place."""
    inner = folder / "images"
    photos = sorted(
        one
        for one in (inner if inner.is_dir() else folder).iterdir()
        if one.suffix.lower() in PHOTOS
    )
    gap = 2 if len(photos) >= 12 else 1
    starts = dict.fromkeys((0, len(photos) // 2))
    chosen = [[start, start + gap] for start in starts]
    if len(photos) >= 12:
        chosen.append([len(photos) // 4 + gap * one for one in range(3)])
    return [
        [photos[one] for one in numbers]
        for numbers in chosen
        if numbers[-1] < len(photos)
    ]


def scenes_of(files: Sequence[Path]) -> dict[str, SceneToJudge]:
    """What the critic is shown of a set, by kind and strength; {}: the photos were refused."""
    views = edit3r.load_views(files, size=SIZE)

    def shown(**how) -> tuple[SceneToJudge, edit3r.RunResult]:
        critic = Keeps(None)
        made = edit3r.run(views, editor="none", critic=critic, **PLAIN, **how)
        return critic.scene, made

    scene, made = shown()
    known = Known(made.records.located.geometry)
    found = {"default": scene}
    sound, made = shown(recon=BrokenReconstructor(), matcher=known)
    draw = functools.partial(render_each, made.rasterizer, text="")
    given = sound.half_way.photos  # in one light, as a reconstructor is handed them
    for kind, strengths in {"sound": (0.0,), **KINDS}.items():
        for strength in strengths:
            broken = BrokenReconstructor(kind, strength)
            answer = broken(given, sound.photos, sound.geometry)
            drawn = draw(answer.gaussians, answer.cameras)
            found[f"{kind} {strength:.3g}"] = replace(
                sound,
                cameras=answer.cameras,
                gaussians=answer.gaussians,
                first=drawn,
                rendered=drawn,
                half_way=seen_half_way(
                    made.rasterizer,
                    answer.gaussians,
                    answer.cameras,
                    given,
                ),
            )
    return found


def row_of(place: str, what: str, scene: SceneToJudge) -> dict:
    """The verdict on a scene, what it stands on, and what is known of it."""
    verdict = LimitsCritic(None).judge_scene(scene)
    kind, _, strength = what.partition(" ")
    number = KINDS[kind].index(float(strength)) + 1 if kind in KINDS else 0

    def worst(name: str) -> float | None:
        known = [one for one in getattr(verdict, name) if one is not None]
        return max(known, default=None)

    pairs = zip(verdict.guessed_between, verdict.unlike_between)
    return {
        "place": place,
        "kind": kind,
        "strength": number,
        "label": verdict.label,
        "part": verdict.part,
        "figures": {
            **{
                name: worst(f"beside_{name}")
                for name in ("geometry", "flat", "reference")
            },
            "half_way": max(sum(one) for one in pairs if None not in one),
            "agreement": min(one for one in verdict.agreement if one is not None),
        },
    }


def main(
    folders: Sequence[Path],
    *,
    keep: Path | None = None,
    rows: Path | None = None,
    most: int = 3,
) -> Iterator[dict]:
    found = []
    with tempfile.TemporaryDirectory() as temporary:
        kept = keep or Path(temporary)
        kept.mkdir(exist_ok=True)
        for folder in folders:
            for number, files in enumerate(sets_of(folder)[:most]):
                path = kept / f"{folder.name}-{number}.pt"
                if not path.exists():
                    try:
                        torch.save(scenes_of(files), path)
                    except Edit3rError as error:
                        print(f"{path.stem}: {str(error)[:90]}")
                        torch.save({}, path)
                scenes = torch.load(path, weights_only=False)
                found += [row_of(folder.name, *one) for one in scenes.items()]
                print(path.stem, flush=True)
    if rows:
        rows.write_text("".join(json.dumps(row) + "\n" for row in found))
    for kind in dict.fromkeys(row["kind"] for row in found):
        for strength in sorted(
            {row["strength"] for row in found if row["kind"] == kind}
        ):
            own = [
                row
                for row in found
                if (row["kind"], row["strength"]) == (kind, strength)
            ]
            bad = sum(row["label"] in ("poor", "failed") for row in own)
            named = sum(row["part"] == "reconstructor" for row in own)
            yield {
                "kind": kind,
                "strength": (KINDS[kind][strength - 1] if strength else 0.0, ".3g"),
                "poor or failed": f"{bad} of {len(own)}",
                "by the reconstructor": f"{named} of {len(own)}",
            }


if __name__ == "__main__":
    run_benchmark(main)
