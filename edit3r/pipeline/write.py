"""What a run leaves behind: one folder of files people can open. The names are those of
`edit3r.io.run_folder`.
"""

import base64
import html
import io
import math
import os
import tempfile
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Cameras, Gaussians
from edit3r.io.cameras import posed_cameras, write_cameras
from edit3r.io.export import FORMATS, export_scene
from edit3r.io.images import Pixels, save_pixels, to_bytes
from edit3r.io.ply import VIEWER_DEGREE, save_ply
from edit3r.io.run_folder import (
    PluginRecord,
    RunFolder,
    RunManifest,
    WeightsRecord,
    write_manifest,
)
from edit3r.io.sheet import draw_sheet
from edit3r.io.video import save_video
from edit3r.io.viewer import colours_before, save_viewer, viewer_page
from edit3r.pipeline.checks import component_name
from edit3r.pipeline.config import RunConfig
from edit3r.pipeline.earlier import note_views
from edit3r.pipeline.rendering import path_around, render_one
from edit3r.pipeline.verdict import WORST_PSNR
from edit3r.reporting import collecting, note, track, warn

if TYPE_CHECKING:
    from edit3r.pipeline.steps import RunResult

VIDEO_FPS = 18
CACHE = "cache"  # folder of the run's cache inside its results


def write(root: Path, result: "RunResult") -> None:
    """Render and write what the run's `outputs` ask for into the existing folder `root`, and
    `run.json`.
    """
    folder, report = RunFolder(root), result.report
    wanted = set(result.config.outputs)
    with collecting(report), torch.no_grad():
        with report.stage("render"), ThreadPoolExecutor(1) as pool:
            # While frames are drawn, all else is written, and the video's frames are coded.
            others = pool.submit(copy_context().run, _write_others, folder, result)
            if wanted & {"video", "frames"}:
                path = path_around(
                    result.cameras.select(_good_views(result)),
                    result.rendered,
                    result.config.frames,
                )
                frames = _frames(result.rasterizer, result.gaussians, path)
                frames = _written(folder, frames) if "frames" in wanted else frames
                if "video" in wanted:
                    save_video(folder.video, frames, VIDEO_FPS)
                deque(frames, maxlen=0)  # those that no video took
        with report.stage("write files"):
            others.result()
            note_views(result.photos)
            note("edits", list(result.prompts))
    write_manifest(folder.manifest, _manifest(result))


def as_html(result: "RunResult") -> str:
    """The sheet and the viewer as one piece of HTML that needs no other file, for notebooks."""
    picture = io.BytesIO()
    _sheet(result).save(picture, "WEBP", quality=85)
    code = base64.b64encode(picture.getvalue()).decode("ascii")
    page = html.escape(viewer_page(result.gaussians, result.cameras, **_look(result)))
    return (
        f'<p>{html.escape(repr(result))}</p><img style="max-width:100%" '
        f'src="data:image/webp;base64,{code}">'
        f'<iframe style="width:100%;height:520px;border:0" srcdoc="{page}"></iframe>'
    )


def open_viewer(result: "RunResult") -> Path:
    """Write the viewer's page to a temporary file and open it in the browser."""
    import webbrowser

    page = Path(tempfile.mkdtemp(prefix="edit3r-")) / "viewer.html"
    save_viewer(page, result.gaussians, result.cameras, **_look(result))
    webbrowser.open(page.as_uri())
    return page


def _look(result: "RunResult") -> dict[str, Any]:
    """Texts and second look of the viewer's page."""
    before = colours_before(
        result.gaussians, result.cameras, result.photos, result.edited, result.rendered
    )
    return {
        "title": result.config.prompt or "edit3r scene",
        "names": result.photos.names,
        "before": before,
    }


def _good_views(result: "RunResult") -> list[int]:
    """View 0 and the views whose photos fit the others; the camera path stays near these."""
    agreement = [psnr for psnr in result.verdict.agreement if psnr is not None]
    good = [
        view
        for view, psnr in enumerate(agreement)
        if view == 0 or psnr >= WORST_PSNR["fair"]
    ]
    return good if len(good) > 1 else list(range(result.cameras.count))


def _frames(
    rasterizer: Rasterizer, gaussians: Gaussians, path: Cameras
) -> Iterator[Pixels]:
    """One image of 8-bit pixels [height, width, 3] for each camera of the path."""
    for index in track(range(path.count), "render camera path"):
        yield to_bytes(
            render_one(rasterizer, gaussians, path.select([index])).images[0, 0]
        )


def _written(folder: RunFolder, frames: Iterator[Pixels]) -> Iterator[Pixels]:
    """The frames, each written as it comes."""
    for index, frame in enumerate(frames):
        save_pixels(frame, folder.renders / f"path_{index:04d}.png")
        yield frame


@torch.no_grad()
def _write_others(folder: RunFolder, result: "RunResult") -> None:
    """Write all that needs no frames of the camera path."""
    wanted = result.config.outputs
    if "cache" in wanted:
        result.cache.save(folder.root / CACHE)
    _write_images(folder, result)
    _write_scene(folder, result)
    if "viewer" in wanted:
        save_viewer(folder.viewer, result.gaussians, result.cameras, **_look(result))


def _write_scene(folder: RunFolder, result: "RunResult") -> None:
    """`scene.ply` is for viewers, and common ones refuse harmonics above degree 3."""
    if "scene" in result.config.outputs:
        if result.gaussians.degree > VIEWER_DEGREE:
            was = result.gaussians.degree
            warn(
                f"scene.ply holds harmonics up to degree {VIEWER_DEGREE} of {was}: viewers "
                "refuse more."
            )
        prompt = " ".join(result.request.prompt.split())
        save_ply(
            folder.scene,
            result.gaussians,
            degree=VIEWER_DEGREE,
            comment_lines=[f"prompt: {prompt}"],
        )
        names = [f"inputs/{name}.png" for name in result.photos.names]
        write_cameras(folder.cameras, posed_cameras(result.cameras, names))
    for form in result.config.export:
        export_scene(folder.scene.with_suffix(FORMATS[form]), result.gaussians, form)


def _write_images(folder: RunFolder, result: "RunResult") -> None:
    if "images" in result.config.outputs:
        jobs = [
            (to_bytes(picture), directory / f"{name}.png")
            for pictures, directory in zip(
                _pictures(result), (folder.inputs, folder.edited, folder.renders)
            )
            for name, picture in zip(result.photos.names, pictures)
        ]
        with ThreadPoolExecutor(os.cpu_count()) as pool:  # coding runs outside the GIL
            list(pool.map(lambda job: save_pixels(*job), jobs))
    if "sheet" in result.config.outputs:
        save_pixels(np.asarray(_sheet(result)), folder.before_after)


def _pictures(result: "RunResult") -> tuple[Float[Tensor, "view 3 height width"], ...]:
    """Photos, 2D edits and the scene from the photos' places."""
    return tuple(
        view.images[0].clamp(0, 1).cpu()
        for view in (result.photos, result.edited, result.rendered)
    )


def _sheet(result: "RunResult") -> Image.Image:
    subtitle = f"editor {component_name(result.editor)}, reconstructor {component_name(result.reconstructor)}; "
    subtitle += f"verdict: {result.verdict.label}"
    if result.left_out is not None:
        subtitle += f"; left out: {', '.join(result.left_out.names)}"
    title = result.request.prompt or "no prompt"
    columns = dict(zip(("photo", "2D edit", "3D result"), _pictures(result)))
    return draw_sheet(
        columns, names=result.photos.names, title=title, subtitle=subtitle
    )


def _manifest(result: "RunResult") -> RunManifest:
    report, config = result.report, result.config
    components = {
        "editor": result.editor,
        "reconstructor": result.reconstructor,
        "rasterizer": result.rasterizer,
    }
    weights = [
        WeightsRecord(**value)
        for key, value in report.notes.items()
        if key.startswith("weights.")
    ]
    settings: dict[str, Any] = {
        "run": config.model_dump(),
        **{k: getattr(c, "settings", None) for k, c in components.items()},
    }
    used = set(result.photos.names)
    return RunManifest(
        prompt=config.prompt,
        seed=config.seed,
        device=config.device,
        settings=settings,
        plugins=[
            record
            for component in components.values()
            for record in plugin_records(component)
        ],
        inputs=[photo for photo in result.records if photo.name in used],
        masks=result.mask_files,
        weights=weights,
        verdict=result.verdict,
        gaussians=result.gaussians.count,
        harmonics_degree=result.gaussians.degree,
        stages=report.stages,
        warnings=report.warnings,
        notes={
            key: value
            for key, value in report.notes.items()
            if not key.startswith("weights.")
        },
    )


def plugin_records(component: Any) -> list[PluginRecord]:
    """The component and the parts it was built with, as the registry remembers them."""
    offer = getattr(component, "offer", None)
    if offer is None:  # an object the caller made by hand
        return []
    own = offer.component
    record = PluginRecord(
        offer.kind,
        own.name,
        offer.plugin,
        offer.version,
        own.licence,
        own.needs_network,
    )
    return [
        record,
        *(r for part in component.parts.values() for r in plugin_records(part)),
    ]


def summary(out: Path, result: "RunResult") -> str:
    """Where to look first, for the end of a run on the command line."""
    folder = RunFolder(out)
    seconds = sum(stage.seconds for stage in result.report.stages)
    height, width = result.cameras.image_size
    quality = result.report.notes.get("quality")
    named = (
        "default"
        if quality is None
        else quality["preset"] or f"measured ({quality['chosen']})"
    )
    size = f"{width}x{height}"
    if (
        quality is not None
        and result.config.size < RunConfig.model_fields["size"].default
    ):
        size = f"photos reduced to {size}"
    made = f"{named} settings, {size}: {result.gaussians.count:,} Gaussians from "
    made += f"{result.photos.count} photos in {seconds:.1f} s"
    places = {
        "look first   {}": folder.before_after,
        "walk around  {} (opens in a browser, no network needed)": folder.viewer,
        "scene        {}": folder.scene,
        "how it was   {}": folder.manifest,
    }
    lines = [
        f"{result.verdict.label}: {result.verdict.reason}",
        f"{made}; {_field_of_view(result)}",
    ]
    return "\n".join(
        [
            *lines,
            *(
                f"  {text.format(place)}"
                for text, place in places.items()
                if place.exists()
            ),
        ]
    )


def _field_of_view(result: "RunResult") -> str:
    """The horizontal field of view that view 0 was used with, and who said so."""
    degrees = math.degrees(
        2 * math.atan(0.5 / float(result.cameras.intrinsics[0, 0, 0, 0]))
    )
    known = not any(result.photos.assumed)
    source = (
        "known"
        if known
        else "read from the photos"
        if "matcher.fov" in result.report.notes
        else "assumed"
    )
    return f"field of view {degrees:.0f} degrees ({source})"
