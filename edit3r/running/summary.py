"""What the command line says at the end of a run."""

import math
from pathlib import Path

from edit3r.contract.verdicts import EditVerdict
from edit3r.running.config import RunConfig, make_run_config
from edit3r.running.records import READ_LENS, SelectedRegions
from edit3r.running.result import RunResult
from edit3r.running.run_folder import RunFolder

MAKES_NO_OTHER_SCENE = {
    "prompt",
    "seed",
    "frames",
    "outputs",
    "export",
    "guess",
    "measure",
    "up",
}
"""Settings that may differ from the defaults without the run being another kind of run."""

# measured by `scenes.py dial`, at the default's size and at 1024 pixels
BEST_COSTS, LARGE_COSTS = "half as long again", "two to four times as long"


IF_RIGHT = " if it is the right thing"


def summary(out: Path, result: RunResult) -> str:
    """The three answers, what was made with which settings, and where to look first."""
    seconds = sum(stage.seconds for stage in result.report.stages)
    height, width = result.cameras.image_size
    lines = [
        *answers(result.records.selection, result.edit_verdict),
        f"scene: {result.verdict.label}, {result.verdict.reason}",
        f"{_named_settings(result)} settings, {width}x{height}: {result.gaussians.count:,} "
        f"Gaussians from {result.photos.count} photos in {seconds:.1f} s; {_field_of_view(result)}",
    ]
    folder = RunFolder(out)
    given = folder.given_scene()
    places = (
        (folder.before_after, "look first   {}"),
        (folder.viewer, "walk around  {} (opens in a browser, no network needed)"),
        (folder.scene if given is None else given[0], "scene        {}"),
        (folder.manifest, "how it was   {}"),
    )
    lines += [f"  {text.format(place)}" for place, text in places if place.exists()]
    return "\n".join([*lines, *_sharper(result)])


def answers(selection: SelectedRegions, edit: EditVerdict | None) -> list[str]:
    """What was selected and how the edit was carried out, a line each; fewer without them."""
    meant = selection.verdict
    lines = [] if meant is None else [f"selected: {meant}."]
    if edit is not None:
        asked = meant is not None and meant.label == "question"
        lines.append(f"edit: {edit.label}{IF_RIGHT if asked else ''}, {edit.reason}.")
    return lines


def _sharper(result: RunResult) -> list[str]:
    """What a scene of default sharpness, that holds, can be told to show more, and its cost."""
    asked, usual = result.components.job.config, make_run_config({})
    if asked.quality is not None or result.verdict.label in ("poor", "failed"):
        return []
    if (asked.size, asked.refine) != (usual.size, usual.refine):
        return []
    longest = max((max(file.size) for file in result.records.inputs.files), default=0)
    best = min(longest, make_run_config({"quality": "best"}).size)
    if best <= usual.size:
        return [f"  sharper      --quality best takes {BEST_COSTS}"]
    scaled = f"scales photos to {best} pixels and not {usual.size}"
    shown = "shows photos at their full size" if best == longest else scaled
    return [f"  sharper      --quality best {shown}, and takes {LARGE_COSTS}"]


def _named_settings(result: RunResult) -> str:
    """The preset or "default", and what was set beside it that makes another scene."""
    asked = result.components.job.config
    preset = {} if asked.quality is None else {"quality": asked.quality}
    usual = make_run_config(preset)
    names = set(RunConfig.model_fields) - MAKES_NO_OTHER_SCENE
    changed = sorted(
        name for name in names if getattr(asked, name) != getattr(usual, name)
    )
    if asked.quality is not None:
        return (
            f"{asked.quality} (but {', '.join(changed)})" if changed else asked.quality
        )
    return f"custom ({', '.join(changed)})" if changed else "default"


def _field_of_view(result: RunResult) -> str:
    """The horizontal field of view that view 0 was used with, and who said so."""
    focal = float(result.cameras.intrinsics[0, 0, 0, 0])  # [image widths]
    degrees = math.degrees(2 * math.atan(0.5 / focal))
    told = map(str, result.report.notes.get("lens.source", ()))
    if not any(result.photos.assumed):
        source = "known"
    elif "lens.alike" in result.report.notes:
        source = (
            "guessed, since the photos do not show it; set it with --fov or --cameras"
        )
    elif any(one.startswith(READ_LENS) for one in told):
        source = "read from the photos"
    else:
        source = "assumed; set it with --fov or --cameras"
    return f"field of view {degrees:.0f} degrees ({source})"
