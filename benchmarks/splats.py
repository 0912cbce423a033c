"""Edits of scans that other programs made, in their own Gaussians; what they cost and how they look
from places that no editor saw.

python benchmarks/splats.py scans|exported|large --help
"""

import itertools
import json
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from harness import Row, run_benchmark
from torch import Tensor

import edit3r
from edit3r.contract.interfaces import Editor, SceneToWrite
from edit3r.contract.reporting import peak_memory_mb
from edit3r.contract.types import EditRequest, Gaussians, Views
from edit3r.kit.compute.lpips import lpips_distance, lpips_weights
from edit3r.kit.contact_sheet import draw_sheet
from edit3r.kit.geometry.cameras import invert_rigid
from edit3r.kit.photos.images import packaged_pair
from edit3r.kit.rendering import OverBackground, render_each, render_numbers
from edit3r.kit.scenes.scene_views import look_around


def scans(
    folder: Path, *, tasks: Path, out: Path = Path("splats"), only: Sequence[str] = ()
) -> Iterator[Row]:
    """Edits of scans in a folder, as a list of tasks in a JSON file says.

        python benchmarks/splats.py scans SCANS --tasks benchmarks/splats.json

    CPU seconds of the whole run and of selecting, Gaussians that changed, the PSNR of the scene
    against the edited pictures, and from eight places between those that were edited: LPIPS to the
    pictures of the scene before, edited directly with the same masks (mean and largest). Sheets of
    these eight, before and after, are left in a folder.
    """
    out.mkdir(exist_ok=True)
    for task in json.loads(tasks.read_text(encoding="utf-8")):
        if only and task["name"] not in only:
            continue
        scan = folder / task["scan"]
        marks = None
        if "point" in task:
            view, x, y = task["point"]
            marks = edit3r.Selection(positive=((view - 1, x, y),))
        began = time.process_time()
        settings = {"outputs": (), **task.get("settings", {})}
        result = edit3r.run(scan, task["prompt"], masks=marks, **settings)
        spent = time.process_time() - began
        stages = {one.name.split(" ")[0]: one for one in result.report.stages}
        distances = _between(result, task["prompt"], out / f"{task['name']}.png")
        notes = result.report.notes
        changed = notes.get("scene.changed") or notes.get("scene.removed")
        agreement = [psnr for psnr in result.verdict.agreement if psnr is not None]
        selected = result.selection_verdict
        row: dict = {
            "task": task["name"],
            "Gaussians": (result.gaussians.count, ",d"),
            "changed": (changed["gaussians"], ",d"),
            "CPU s": (spent, ".0f"),
            "wall s of select": (stages["select"].seconds, ".0f"),
            "dB": (float(np.mean(agreement)) if agreement else np.nan, ".1f"),
            "selected": "" if selected is None else selected.short,
            "scene": result.verdict.label,
        }
        if distances:
            row["LPIPS"] = (float(np.mean(distances)), ".3f")
            row["largest"] = (max(distances), ".3f")
        yield row


@torch.no_grad()
def _between(result: edit3r.RunResult, prompt: str, sheet: Path) -> list[float]:
    """LPIPS from between the edited pictures; a sheet of them is left in a file."""
    given = result.records.inputs.scene
    rasterizer = edit3r.build("rasterizer", "numba")
    size = given.places.cameras.image_size
    places = look_around(given.given, rasterizer, count=16, size=size)
    c2w = invert_rigid(given.views.c2w[None])[0] @ places.cameras.c2w[:, 1::2]
    c2w[..., :3, 3] /= given.views.unit
    cameras = replace(
        places.cameras, c2w=c2w, intrinsics=places.cameras.intrinsics[:, 1::2]
    )
    shown = OverBackground(rasterizer, given.views.scene.background)
    before = given.views.scene.gaussians
    images = [
        render_each(shown, one, cameras, "look").images.clamp(0, 1)
        for one in (before, result.gaussians)
    ]
    columns = {"before": images[0][0], "after": images[1][0]}
    distances: list[float] = []
    editor = result.editor
    kept = result.records.reconstructed.reconstruction.kept
    is_paint = editor.offer.component.name == "recolor" and bool(kept.all())
    if is_paint and lpips_weights():
        changed = (result.gaussians.harmonics != before.harmonics).flatten(2).any(2)
        mask = render_numbers(rasterizer, before, changed.float(), cameras).images
        mask = mask[:, :, 0].clamp(0, 1)
        direct = _edited(editor, images[0], cameras.intrinsics, mask, result)
        columns["edited directly"] = direct[0]
        pairs = zip(images[1][0], direct[0])
        distances = [
            lpips_distance(*(one.permute(1, 2, 0).numpy() for one in pair))
            for pair in pairs
        ]
    names = [f"between_{k + 1}" for k in range(8)]
    draw_sheet(columns, names=names, title=prompt).save(sheet)
    return distances


def _edited(
    editor: Editor,
    images: Tensor,
    intrinsics: Tensor,
    mask: Tensor,
    result: edit3r.RunResult,
) -> Tensor:
    """The pictures with the run's 2D edit inside a mask."""
    instructions = result.records.selection.instructions
    regions = mask.expand(len(instructions), *mask.shape)
    request = EditRequest(
        result.config.prompt, masks=mask, instructions=instructions, regions=regions
    )
    answer = editor.edit(Views(images, intrinsics), request)
    return images + (mask > 0).to(mask)[:, :, None] * (answer.images - images)


def exported(*, size: int = 384) -> Iterator[Row]:
    """The packaged pair, edited from its photos and as a scene that was made of them before.

        python benchmarks/splats.py exported

    PSNR [dB] of both scenes at the photos, against the photos edited in 2D with the same masks.
    """
    files, cameras = packaged_pair()
    folder = Path(cameras).parent
    masks = [folder / f"motorcycle_mask{side}.png" for side in ("", "_right")]
    prompt = "paint the motorcycle blue"
    chosen = {"cameras": cameras, "size": size, "outputs": ()}
    direct = edit3r.run(files, prompt, masks=masks, **chosen)
    plain = edit3r.run(files, editor="none", **chosen)
    target = direct.edited.images[0]
    shown = {"its photos": direct.rendered.images[0]}
    for name in ("ply", "spz"):
        with tempfile.TemporaryDirectory() as scratch:
            writer = edit3r.build("writer", name)
            file = Path(scratch) / f"scene{writer.offer.component.suffix}"
            writer.write(file, SceneToWrite(plain.gaussians))
            again = edit3r.run(
                file,
                prompt,
                cameras=plain.cameras,
                masks=direct.masks,
                size=size,
                outputs=(),
            )
        shown[f"the scene as {name}"] = again.rendered.images[0]
    for name, images in shown.items():
        error = ((images.clamp(0, 1) - target) ** 2).mean((1, 2, 3))
        levels = (-10 * error.log10()).tolist()
        yield {
            "edited from": name,
            **{f"photo {k + 1}, dB": (one, ".1f") for k, one in enumerate(levels)},
        }


def large(*, counts: Sequence[int] = (100_000, 1_000_000)) -> Iterator[Row]:
    """A colour by a click on a made scene of so many Gaussians: seconds and memory.

        python benchmarks/splats.py large --counts 1000000

    Seconds are those of the clock and of the processor, memory the most that the process held.
    """
    for count in counts:
        gaussians = _made(count)
        began, spent = time.perf_counter(), time.process_time()
        marks = edit3r.Selection(positive=((0, 0.5, 0.5),))
        result = edit3r.run(gaussians, "paint it blue", masks=marks, outputs=())
        yield {
            "Gaussians": (count, ",d"),
            "s": (time.perf_counter() - began, ".0f"),
            "CPU s": (time.process_time() - spent, ".0f"),
            "GB": (peak_memory_mb() / 1024, ".1f"),
            "changed": (result.report.notes["scene.changed"]["gaussians"], ",d"),
        }


def _made(count: int) -> Gaussians:
    """A large ball among small ones on a floor, with harmonics of degree 3."""
    generator = torch.Generator().manual_seed(0)
    balls = [((0.0, 0.0, 0.0), 0.5, 0.5)]
    for turn in range(8):
        angle = torch.tensor(2 * torch.pi * turn / 8)
        balls.append(((float(angle.cos()), 0.35, float(angle.sin())), 0.15, 0.03))
    parts, colours = [], []
    for (centre, radius, share), colour in zip(balls, itertools.count()):
        points = torch.randn(round(share * count), 3, generator=generator)
        points = torch.nn.functional.normalize(points, dim=1)
        parts.append(torch.tensor(centre) + radius * points)
        tone = torch.tensor([0.7, 0.3 + 0.05 * colour, 0.2])
        colours.append(tone.expand(len(points), 3))
    rest = count - sum(len(part) for part in parts)
    floor = 3 * torch.rand(rest, 3, generator=generator) - 1.5
    floor[:, 1] = 0.51
    parts.append(floor)
    colours.append(torch.full((rest, 3), 0.5))
    means = torch.cat(parts)
    harmonics = 0.02 * torch.randn(count, 16, 3, generator=generator)
    harmonics[:, 0] = (torch.cat(colours) - 0.5) / 0.28209479
    quats = torch.zeros(count, 4)
    quats[:, 0] = 1
    size = 1.2 * (3.14 / count) ** 0.5
    return Gaussians(
        means[None],
        torch.full((1, count, 3), size),
        quats[None],
        torch.full((1, count), 0.9),
        harmonics[None],
    )


if __name__ == "__main__":
    run_benchmark(scans, exported, large)
