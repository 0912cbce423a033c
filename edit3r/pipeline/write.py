"""What a run leaves behind: one folder of files people can open. The names are those of
`edit3r.io.run_folder`.
"""

import base64
import html
import io
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
from edit3r.contract.types import Cameras, Gaussians, Rendering, Views
from edit3r.errors import InputError
from edit3r.io.cameras import posed_cameras, write_cameras
from edit3r.io.export import FORMATS, export_scene
from edit3r.io.images import Pixels, save_pixels, to_bytes
from edit3r.io.outline import outlined
from edit3r.io.ply import VIEWER_DEGREE, save_ply
from edit3r.io.run_folder import (
    PluginRecord,
    RunFolder,
    RunManifest,
    WeightsRecord,
    write_manifest,
)
from edit3r.io.sheet import draw_sheet, stacked
from edit3r.io.video import save_video
from edit3r.io.viewer import colours_before, save_viewer, viewer_page
from edit3r.pipeline.checks import component_name
from edit3r.pipeline.earlier import CACHE, THINGS, note_views
from edit3r.pipeline.rendering import path_around, render_one
from edit3r.pipeline.scene import Scene
from edit3r.pipeline.verdict import WORST_PSNR
from edit3r.reporting import collecting, note, track, warn
from edit3r.selection.select import Reading, Selected

if TYPE_CHECKING:
    from edit3r.pipeline.run import RunResult

VIDEO_FPS = 18


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
            note("edits", list(result.scene.prompts))
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
    photos, edited = map(result.scene.in_one_light, (result.photos, result.edited))
    before = colours_before(
        result.gaussians, result.cameras, photos, edited, result.rendered
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
        prompt = " ".join(result.config.prompt.split())
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
        _write_masks(folder, result)
    if "sheet" in result.config.outputs:
        save_pixels(np.asarray(_sheet(result)), folder.before_after)


def _write_masks(folder: RunFolder, result: "RunResult") -> None:
    """Masks of what was named, which a further edit knows by these names."""
    things = result.scene.things
    for place, masks in enumerate(things.values()):
        masks_folder = folder.masks / str(place)
        masks_folder.mkdir()
        for name, mask in zip(result.photos.names, masks):
            save_pixels(to_bytes(mask.expand(3, -1, -1)), masks_folder / f"{name}.png")
    if things:
        note(THINGS, list(things))


def _pictures(result: "RunResult") -> tuple[Float[Tensor, "view 3 height width"], ...]:
    """Photos, 2D edits and the scene from the photos' places."""
    return _images(result.photos), _images(result.edited), _images(result.rendered)


def _sheet(result: "RunResult") -> Image.Image:
    subtitle = (
        f"editor {result.parts.editor_names}, "
        f"reconstructor {component_name(result.reconstructor)}; "
        f"scene: {result.verdict.label}"
    )
    if result.edit_verdict is not None:
        subtitle += f", edit: {result.edit_verdict.label}"
    if result.scene.left_out is not None:
        subtitle += f"; left out: {', '.join(result.scene.left_out.names)}"
    title = result.config.prompt or "no prompt"
    scene = result.scene
    subtitle += _how_sure(scene)
    columns = {
        "photo": _outlined_photos(scene),
        "2D edit": _images(scene.edited),
        "3D result": _images(result.rendered),
    }
    sheet = draw_sheet(
        columns, names=result.photos.names, title=title, subtitle=subtitle
    )
    return _with_readings(sheet, scene)


def _with_readings(sheet: Image.Image, scene: Scene) -> Image.Image:
    """The sheet with what else words may mean below it, where they were unsure."""
    unsure = [one for one in scene.selected if not one.is_sure]
    placed = scene.placed or (True,) * scene.photos.count
    for selected in unsure:
        shown = [one for one in selected.readings if placed[one.view]]
        if len(shown) < 2:
            continue
        view = sum(placed[: shown[0].view])
        photo, name = _images(scene.photos)[view], scene.photos.names[view : view + 1]
        columns = {
            _caption(one, selected): outlined(photo, one.mask)[None] for one in shown
        }
        strip = draw_sheet(columns, names=name, title="What else it may be")
        sheet = stacked(sheet, strip)
    return sheet


def _caption(reading: Reading, selected: Selected) -> str:
    taken = " (taken)" if reading.number == selected.taken else ""
    return f"--reading {reading.number}{taken}"


def comparison(result: "RunResult", other: "RunResult") -> Image.Image:
    """The sheet of two results of the same photos: photo, the one scene, the other scene."""
    names = result.photos.names
    if other.photos.names != names:
        raise InputError(
            f"these are results of different photos: {', '.join(names)}, and "
            f"{', '.join(other.photos.names)}."
        )
    columns = {"photo": _images(result.photos)}
    lines = []
    for each, name in ((result, "first"), (other, "second")):
        columns[name] = _images(each.rendered)
        lines.append(f"{name}: {each.config.prompt} ({each.verdict.label})")
    return draw_sheet(columns, names=names, subtitle="; ".join(lines))


def preview_sheet(scene: Scene, prompt: str) -> Image.Image:
    """The sheet of what `edit3r.pipeline.run.preview` returns: photos with the outline of what is
    selected, and the 2D edit.
    """
    columns = {"photo": _outlined_photos(scene), "2D edit": _images(scene.edited)}
    sheet = draw_sheet(
        columns,
        names=scene.photos.names,
        title=prompt or "no prompt",
        subtitle=_preview_line(scene),
    )
    return _with_readings(sheet, scene)


def _preview_line(scene: Scene) -> str:
    line = "preview: nothing is reconstructed yet" + _how_sure(scene)
    if scene.edit_verdict is None:
        return line
    return f"{line}; edit: {scene.edit_verdict.label}"


def _how_sure(scene: Scene) -> str:
    """How surely the words found what they name, where that was by learned words."""
    unsure = [one.surety for one in scene.selected if (one.surety or 1.0) < 1]
    return "".join(f"; selected by words, {surety:.0%} sure" for surety in unsure)


def _images(views: Views | Rendering) -> Float[Tensor, "view 3 height width"]:
    return views.images[0].clamp(0, 1).cpu()


def _outlined_photos(scene: Scene) -> Float[Tensor, "view 3 height width"]:
    """The photos, with the outline of what is selected."""
    photos = _images(scene.photos)
    if scene.masks is None:
        return photos
    pairs = zip(photos, scene.masks[0])
    return torch.stack([outlined(photo, mask) for photo, mask in pairs])


def _manifest(result: "RunResult") -> RunManifest:
    report, config = result.report, result.config
    components = {
        "editor": result.editor,
        "reconstructor": result.reconstructor,
        "rasterizer": result.rasterizer,
    }
    settings = {
        kind: getattr(one, "settings", None) for kind, one in components.items()
    }
    used = [
        *(task.editor for task in result.parts.tasks),
        *list(components.values())[1:],
    ]
    plugins = [record for one in used for record in plugin_records(one)]
    weights = {k: v for k, v in report.notes.items() if k.startswith("weights.")}
    notes = {k: v for k, v in report.notes.items() if k not in weights}
    return RunManifest(
        prompt=config.prompt,
        seed=config.seed,
        device=config.device,
        settings={"run": config.model_dump(), **settings},
        plugins=plugins,
        inputs=result.scene.records,
        masks=result.scene.mask_files,
        weights=[WeightsRecord(**facts) for facts in weights.values()],
        verdict=result.verdict,
        edit_verdict=result.edit_verdict,
        gaussians=result.gaussians.count,
        harmonics_degree=result.gaussians.degree,
        stages=report.stages,
        warnings=report.warnings,
        notes=notes,
    )


def plugin_records(component: Any) -> list[PluginRecord]:
    """The component and the parts it was built with, as the registry remembers them."""
    offer = getattr(component, "offer", None)
    if offer is None:  # an object the caller made by hand
        return []
    records = [
        PluginRecord(
            kind=offer.kind,
            name=offer.component.name,
            plugin=offer.plugin,
            version=offer.version,
            licence=offer.component.licence,
            needs_network=offer.component.needs_network,
        )
    ]
    for part in component.parts.values():
        records += plugin_records(part)
    return records
