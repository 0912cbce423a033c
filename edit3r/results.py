"""What a run leaves behind: one folder of files people can open. The names are those of `edit3r.io.run_folder`."""

import math
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from edit3r.earlier_run import note_views
from edit3r.interfaces import Rasterizer
from edit3r.io.cameras import posed_cameras, write_cameras
from edit3r.io.images import LoadedPhotos, Pixels, save_pixels, to_bytes
from edit3r.io.ply import VIEWER_DEGREE, save_ply
from edit3r.io.run_folder import PluginRecord, RunFolder, RunManifest, WeightsRecord, write_manifest
from edit3r.io.sheet import save_before_after
from edit3r.io.video import save_video
from edit3r.io.viewer import save_viewer
from edit3r.rendering import path_around, render_one
from edit3r.reporting import collecting, note, track, warn
from edit3r.stage_checks import component_name
from edit3r.types import Cameras, Gaussians
from edit3r.verdict import WORST_PSNR

if TYPE_CHECKING:
    from edit3r.pipeline import RunResult
    from edit3r.run_config import RunConfig

VIDEO_FPS = 18
CACHE = "cache"  # folder of the run's cache inside its results


def write(
    root: Path,
    result: "RunResult",
    photos: LoadedPhotos,
    masks: dict[str, str],
    config: "RunConfig",
) -> None:
    """Render and write everything into the existing folder `root`; `masks` is mask file to sha256."""
    folder = RunFolder(root)
    report = result.report
    with collecting(report), torch.no_grad():
        with report.stage("render"), ThreadPoolExecutor(1) as pool:
            saving = pool.submit(result.cache.save, root / CACHE)  # compresses while the frames are drawn
            path = path_around(result.cameras.select(_good_views(result)), result.rendered, config.frames)
            frames = _frames(result.rasterizer, result.gaussians, path)
            saving.result()
        with report.stage("write files"):
            _write_images(folder, result, frames)
            _write_scene(folder, result)
            names = [f"inputs/{name}.png" for name in result.photos.names]
            write_cameras(folder.cameras, posed_cameras(result.cameras, names))
            save_video(folder.video, frames, VIDEO_FPS)
            title = config.prompt or "edit3r scene"
            save_viewer(folder.viewer, result.gaussians, result.cameras, title=title, names=result.photos.names)
            note_views(result.photos)
            note("edits", list(result.prompts))
    write_manifest(folder.manifest, _manifest(result, photos, masks, config))


def _good_views(result: "RunResult") -> list[int]:
    """View 0 and the views whose photos fit the others; the camera path stays near these."""
    agreement = [psnr for psnr in result.verdict.agreement if psnr is not None]
    good = [view for view, psnr in enumerate(agreement) if view == 0 or psnr >= WORST_PSNR["fair"]]
    return good if len(good) > 1 else list(range(result.cameras.count))


def _frames(rasterizer: Rasterizer, gaussians: Gaussians, path: Cameras) -> list[Pixels]:
    """One image of 8-bit pixels [height, width, 3] for each camera of the path."""
    cameras = track(range(path.count), "render camera path")
    return [to_bytes(render_one(rasterizer, gaussians, path.select([index])).images[0, 0]) for index in cameras]


def _write_scene(folder: RunFolder, result: "RunResult") -> None:
    """`scene.ply` is for viewers, and common ones refuse harmonics above degree 3."""
    if result.gaussians.degree > VIEWER_DEGREE:
        warn(
            f"scene.ply holds harmonics up to degree {VIEWER_DEGREE} of {result.gaussians.degree}: viewers refuse more."
        )
    prompt = " ".join(result.request.prompt.split())
    save_ply(folder.scene, result.gaussians, degree=VIEWER_DEGREE, comment_lines=[f"prompt: {prompt}"])


def _write_images(folder: RunFolder, result: "RunResult", frames: list[Pixels]) -> None:
    views = [result.photos.images[0].cpu(), result.edited.images[0].cpu(), result.rendered.images[0].clamp(0, 1).cpu()]
    jobs = [
        (to_bytes(picture), directory / f"{name}.png")
        for pictures, directory in zip(views, (folder.inputs, folder.edited, folder.renders))
        for name, picture in zip(result.photos.names, pictures)
    ]
    jobs += [(frame, folder.renders / f"path_{index:04d}.png") for index, frame in enumerate(frames)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # coding runs outside the GIL
        list(pool.map(lambda job: save_pixels(*job), jobs))
    subtitle = f"editor {component_name(result.editor)}, reconstructor {component_name(result.reconstructor)}; "
    subtitle += f"verdict: {result.verdict.label}"
    if result.left_out is not None:
        subtitle += f"; left out: {', '.join(result.left_out.names)}"
    title = result.request.prompt or "no prompt"
    save_before_after(folder.before_after, *views, names=result.photos.names, title=title, subtitle=subtitle)


def _manifest(result: "RunResult", photos: LoadedPhotos, masks: dict[str, str], config: "RunConfig") -> RunManifest:
    report = result.report
    components = {"editor": result.editor, "reconstructor": result.reconstructor, "rasterizer": result.rasterizer}
    weights = [WeightsRecord(**value) for key, value in report.notes.items() if key.startswith("weights.")]
    settings: dict[str, Any] = {"run": config.model_dump(), **{k: c.settings for k, c in components.items()}}
    used = set(result.photos.names)
    return RunManifest(
        prompt=config.prompt,
        seed=config.seed,
        device=config.device,
        settings=settings,
        plugins=[record for component in components.values() for record in plugin_records(component)],
        inputs=[photo for photo in photos.photos if photo.name in used],
        masks=masks,
        weights=weights,
        verdict=result.verdict,
        gaussians=result.gaussians.count,
        harmonics_degree=result.gaussians.degree,
        stages=report.stages,
        warnings=report.warnings,
        notes={key: value for key, value in report.notes.items() if not key.startswith("weights.")},
    )


def plugin_records(component: Any) -> list[PluginRecord]:
    """The component and the parts it was built with, as the registry remembers them."""
    offer = getattr(component, "offer", None)
    if offer is None:  # an object the caller made by hand
        return []
    own = offer.component
    record = PluginRecord(offer.kind, own.name, offer.plugin, offer.version, own.licence, own.needs_network)
    return [record, *(r for part in component.parts.values() for r in plugin_records(part))]


def summary(out: Path, result: "RunResult") -> str:
    """Where to look first, for the end of a run on the command line."""
    folder = RunFolder(out)
    seconds = sum(stage.seconds for stage in result.report.stages)
    height, width = result.cameras.image_size
    preset = result.report.notes.get("quality", {}).get("preset") or "default"
    made = f"{preset} settings at {width}x{height}: {result.gaussians.count:,} Gaussians from "
    made += f"{result.photos.count} photos in {seconds:.1f} s"
    return (
        f"{result.verdict.label}: {result.verdict.reason}\n"
        f"{made}; {_field_of_view(result)}\n"
        f"  look first   {folder.before_after}\n"
        f"  walk around  {folder.viewer} (opens in a browser, no network needed)\n"
        f"  scene        {folder.scene}\n"
        f"  how it was   {folder.manifest}"
    )


def _field_of_view(result: "RunResult") -> str:
    """The horizontal field of view that view 0 was used with, and who said so."""
    degrees = math.degrees(2 * math.atan(0.5 / float(result.cameras.intrinsics[0, 0, 0, 0])))
    known = not any(result.photos.assumed)
    source = "known" if known else "read from the photos" if "matcher.fov" in result.report.notes else "assumed"
    return f"field of view {degrees:.0f} degrees ({source})"
