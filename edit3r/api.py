"""The easy call from Python: `edit3r.run(photos, "paint the bike red", editor="recolor",
recon="edit3r")`.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxtyping import Float
from torch import Tensor

from edit3r.cache import Cache
from edit3r.config import PartChoice
from edit3r.contract.types import Views
from edit3r.pipeline.config import PART_KEYS, make_run_config
from edit3r.pipeline.steps import RunResult, lens_of
from edit3r.pipeline.steps import run as run_pipeline
from edit3r.plugins.registry import Registry, default_registry
from edit3r.reporting import Report, collecting
from edit3r.selection.select import Selection

if TYPE_CHECKING:
    from edit3r.io.images import Photo


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
    """Edit photos as `prompt` says and reconstruct them in 3D; see `edit3r.pipeline.steps.run` for
    what happens.

    `views` are loaded views, or photo files, folders and videos. `recon` (the reconstructor), and
    in `settings` `editor`, `segmenter` and `rasterizer`, are names, names with settings, or built
    objects. All other `settings` are those of `RunConfig`, such as `seed=0`, `edit_views="first"`,
    `gaussians="auto"` or `refine=10`. A `cache` that is passed to several runs keeps what they have
    in common from being computed twice. What the run warns of comes as warnings of Python's too,
    unless a `report` is passed to collect it.
    """
    from edit3r.io.images import load_photos

    chosen = {**settings, **({} if recon is None else {"reconstructor": recon})}
    components = {
        key: chosen.pop(key) for key in PART_KEYS if _is_built(chosen.get(key))
    }
    named = {key: _plain(value) for key, value in chosen.items()}
    records: tuple["Photo", ...] = ()
    own = report or Report()
    with collecting(own):
        if not isinstance(views, Views):
            asked = make_run_config(named)
            read_lens = partial(lens_of, asked, registry or default_registry())
            loaded = load_photos(
                views,
                fov=asked.fov,
                size=asked.size,
                most=asked.views,
                read_lens=read_lens,
            )
            views, records = loaded.views, loaded.photos
        config = make_run_config({"prompt": prompt, **named}, photos=views.count)
        result = run_pipeline(
            views,
            config,
            masks=masks,
            components=components,
            registry=registry,
            report=own,
            cache=cache,
        )
    for text in own.warnings if report is None else ():
        warnings.warn(text, stacklevel=2)
    return replace(result, records=records)


def _is_built(choice: Any) -> bool:
    return choice is not None and not isinstance(choice, str | Mapping | PartChoice)


def _plain(value: Any) -> Any:
    """A PartChoice as the mapping that configuration files hold."""
    return (
        {"name": value.name, **value.settings}
        if isinstance(value, PartChoice)
        else value
    )
