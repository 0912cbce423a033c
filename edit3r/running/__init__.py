"""Drive a run: what commands, the app and benchmarks need of it.

A name here is promised; the modules behind may change. Each loads on first use.
"""

from importlib import import_module

TYPE_CHECKING = False  # as in typing, which takes a while to import

_HOME = {
    "check_components": "edit3r.running.config",
    "DEFAULTS": "edit3r.running.config",
    "JobInputs": "edit3r.running.config",
    "MAX_GROWTH": "edit3r.running.config",
    "MAX_PROMPT": "edit3r.running.config",
    "MAX_STEPS": "edit3r.running.config",
    "PART_KEYS": "edit3r.running.config",
    "RunConfig": "edit3r.running.config",
    "make_run_config": "edit3r.running.config",
    "CACHE": "edit3r.running.earlier",
    "read_earlier_run": "edit3r.running.earlier",
    "read_views_of_run": "edit3r.running.earlier",
    "usual_reader": "edit3r.running.reading",
    "wishes_for": "edit3r.running.reading",
    "add_flags": "edit3r.running.flags",
    "add_mark_flags": "edit3r.running.flags",
    "given_flags": "edit3r.running.flags",
    "RunJob": "edit3r.running.job",
    "job_from": "edit3r.running.job",
    "EditVerdict": "edit3r.running.judging.edit_verdict",
    "LABELS": "edit3r.running.judging.verdict",
    "Parts": "edit3r.running.parts",
    "Expected": "edit3r.running.quality",
    "MeasuredPoint": "edit3r.running.quality",
    "PRESETS": "edit3r.running.quality",
    "Quality": "edit3r.running.quality",
    "write_quality": "edit3r.running.quality",
    "RunResult": "edit3r.running.loop",
    "preview": "edit3r.running.loop",
    "run": "edit3r.running.loop",
    "Scene": "edit3r.running.scene",
    "MarkTexts": "edit3r.running.selecting.marks",
    "Box": "edit3r.running.selecting.select",
    "MIN_AREA": "edit3r.running.selecting.select",
    "Reading": "edit3r.running.selecting.select",
    "Selection": "edit3r.running.selecting.select",
    "geometry_of": "edit3r.running.selecting.geometry",
    "default_matcher": "edit3r.running.selecting.geometry",
    "select_with": "edit3r.running.selecting.call",
    "SURE": "edit3r.running.selecting.select",
    "select_masks": "edit3r.running.selecting.select",
    "SavedScene": "edit3r.running.saved",
    "write_saved": "edit3r.running.saved",
    "write_result": "edit3r.running.write",
}

__all__ = [
    "CACHE",
    "DEFAULTS",
    "LABELS",
    "MAX_GROWTH",
    "MAX_PROMPT",
    "MAX_STEPS",
    "MIN_AREA",
    "PART_KEYS",
    "PRESETS",
    "SURE",
    "Box",
    "EditVerdict",
    "Expected",
    "JobInputs",
    "MarkTexts",
    "MeasuredPoint",
    "Parts",
    "Quality",
    "Reading",
    "RunConfig",
    "RunJob",
    "RunResult",
    "SavedScene",
    "Scene",
    "Selection",
    "add_flags",
    "add_mark_flags",
    "check_components",
    "default_matcher",
    "geometry_of",
    "given_flags",
    "job_from",
    "make_run_config",
    "preview",
    "read_earlier_run",
    "read_views_of_run",
    "run",
    "select_masks",
    "select_with",
    "usual_reader",
    "wishes_for",
    "write_quality",
    "write_result",
    "write_saved",
]


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'edit3r.running' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__


if TYPE_CHECKING:
    from edit3r.running.config import (
        DEFAULTS,
        MAX_GROWTH,
        MAX_PROMPT,
        MAX_STEPS,
        PART_KEYS,
        JobInputs,
        RunConfig,
        check_components,
        make_run_config,
    )
    from edit3r.running.earlier import CACHE, read_earlier_run, read_views_of_run
    from edit3r.running.flags import add_flags, add_mark_flags, given_flags
    from edit3r.running.job import RunJob, job_from
    from edit3r.running.judging.edit_verdict import EditVerdict
    from edit3r.running.judging.verdict import LABELS
    from edit3r.running.loop import RunResult, preview, run
    from edit3r.running.parts import Parts
    from edit3r.running.quality import (
        PRESETS,
        Expected,
        MeasuredPoint,
        Quality,
        write_quality,
    )
    from edit3r.running.reading import usual_reader, wishes_for
    from edit3r.running.saved import SavedScene, write_saved
    from edit3r.running.scene import Scene
    from edit3r.running.selecting.call import select_with
    from edit3r.running.selecting.geometry import default_matcher, geometry_of
    from edit3r.running.selecting.marks import MarkTexts
    from edit3r.running.selecting.select import (
        MIN_AREA,
        SURE,
        Box,
        Reading,
        Selection,
        select_masks,
    )
    from edit3r.running.write import write_result
