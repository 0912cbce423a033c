"""The easy call from Python: `edit3r.run(photos, "paint the bike red", editor="recolor", recon="edit3r")`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxtyping import Float
from torch import Tensor

from edit3r.cache import Cache
from edit3r.config import PartChoice
from edit3r.pipeline import RunResult
from edit3r.pipeline import run as run_pipeline
from edit3r.registry import Registry
from edit3r.reporting import Report
from edit3r.run_config import PART_KEYS, make_run_config
from edit3r.selection import Selection
from edit3r.types import Views


def run(
    views: Views | str | Path | Sequence[str | Path],
    prompt: str = "",
    *,
    recon: str | Mapping | PartChoice | Any | None = None,
    masks: Float[Tensor, "batch view height width"] | Selection | None = None,
    registry: Registry | None = None,
    report: Report | None = None,
    cache: Cache | None = None,
    **settings: Any,
) -> RunResult:
    """Edit photos as `prompt` says and reconstruct them in 3D; see `edit3r.pipeline.run` for what happens.

    `views` are loaded views, or photo files and folders. `recon` (the reconstructor), and in `settings` `editor`,
    `segmenter` and `rasterizer`, are names, names with settings, or built objects. All other `settings` are those of
    `RunConfig`, such as `seed=0`, `edit_views="first"`, `gaussians="auto"` or `refine=10`. A `cache` that is passed to
    several runs keeps what they have in common from being computed twice.
    """
    chosen = {**settings, **({} if recon is None else {"reconstructor": recon})}
    components = {key: chosen.pop(key) for key in PART_KEYS if _is_built(chosen.get(key))}
    named = {key: _plain(value) for key, value in chosen.items()}
    if not isinstance(views, Views):
        from edit3r.io.images import load_views

        views = load_views(views, fov=named.get("fov"), size=named.get("size", 512))
    config = make_run_config({"prompt": prompt, **named}, photos=views.count)
    return run_pipeline(
        views, config, masks=masks, components=components, registry=registry, report=report, cache=cache
    )


def _is_built(choice: Any) -> bool:
    return choice is not None and not isinstance(choice, str | Mapping | PartChoice)


def _plain(value: Any) -> Any:
    """A PartChoice as the mapping that configuration files hold."""
    return {"name": value.name, **value.settings} if isinstance(value, PartChoice) else value
