"""What a run leaves behind: one folder of files people can open. The names are those of `edit3r.io.run_folder`."""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from edit3r_refiners.footprint import measured_footprint

from edit3r.geometry.paths import between_and_around
from edit3r.interfaces import Rasterizer
from edit3r.io.cameras import posed_cameras, write_cameras
from edit3r.io.images import LoadedPhotos, Pixels, save_pixels, to_bytes
from edit3r.io.ply import VIEWER_DEGREE, save_ply
from edit3r.io.run_folder import PluginRecord, RunFolder, RunManifest, WeightsRecord, recorded, write_manifest
from edit3r.io.sheet import save_before_after
from edit3r.io.video import save_video
from edit3r.io.viewer import save_viewer
from edit3r.reporting import collecting, note, track, warn
from edit3r.reuse.fingerprint import identity
from edit3r.reuse.frames import Render, changed_between, earlier_frames, hash_of, redraw
from edit3r.reuse.state import FOLDER, Drawn, SceneState, frame_file, save_state
from edit3r.stage_checks import blaming, check_rendering, component_name
from edit3r.types import Cameras, Gaussians, Reconstruction, Rendering

if TYPE_CHECKING:
    from edit3r.pipeline import RunResult
    from edit3r.run_config import RunConfig

VIDEO_FPS = 18


def write(
    root: Path,
    result: "RunResult",
    photos: LoadedPhotos,
    masks: dict[str, str],
    rasterizer: Rasterizer,
    config: "RunConfig",
    earlier: SceneState | None = None,
) -> None:
    """Render and write everything into the existing folder `root`; `masks` is mask file to sha256.

    What the scene of an `earlier` run shows alike is taken from its pictures.
    """
    folder = RunFolder(root)
    report = result.report
    with collecting(report), torch.no_grad():
        with report.stage("render"):
            rendered = render_each(rasterizer, result.gaussians, result.cameras, "render input views")
            path, frames = _camera_path(result, rendered, rasterizer, config.frames, earlier)
            note("render.coverage_of_input_views", [round(float(a.mean()), 4) for a in rendered.alphas[0]])
        with report.stage("write files"):
            _write_pictures(folder, result, rendered, frames)
            _write_scene(folder, result)
            names = [f"inputs/{name}.png" for name in result.photos.names]
            write_cameras(folder.cameras, posed_cameras(result.cameras, names))
            save_video(folder.video, frames, VIDEO_FPS)
            title = config.prompt or "edit3r scene"
            save_viewer(folder.viewer, result.gaussians, result.cameras, title=title, names=result.photos.names)
            _write_for_editing_again(folder, result, photos, path, rasterizer, config)
    write_manifest(folder.manifest, _manifest(result, photos, masks, rasterizer, config))


def render_each(rasterizer: Rasterizer, gaussians: Gaussians, cameras: Cameras, text: str) -> Rendering:
    """Render camera by camera, showing progress."""
    parts = [_render_one(rasterizer, gaussians, cameras.select([i])) for i in track(range(cameras.count), text)]
    return Rendering(*(torch.cat([getattr(p, name) for p in parts], 1) for name in ("images", "alphas", "depths")))


def _render_one(rasterizer: Rasterizer, gaussians: Gaussians, camera: Cameras) -> Rendering:
    with blaming(rasterizer):
        rendering = rasterizer.render(gaussians, camera)
    check_rendering(rasterizer, gaussians, camera, rendering)
    return rendering


def path_around(cameras: Cameras, rendered: Rendering, frames: int) -> Cameras:
    """A camera path between and around `cameras`, whose swing is bounded by the depth of what they show."""
    seen = rendered.depths[rendered.alphas > 0.5]
    return between_and_around(cameras, frames, float(seen.median()) if seen.numel() else None)


def _camera_path(
    result: "RunResult", rendered: Rendering, rasterizer: Rasterizer, count: int, earlier: SceneState | None
) -> tuple[Cameras, list[Pixels]]:
    """The camera path and its pictures; after an earlier run the same path, drawn again where something changed."""
    draw = partial(_render_one, rasterizer)
    path, drawn = path_around(result.cameras, rendered, count), None
    if earlier is not None and earlier.path.count == count and _same(result.cameras, earlier.scene.cameras):
        path = earlier.path.to(path.c2w)
        drawn = _redrawn(result.gaussians, path, rasterizer, earlier, draw)
    note("reuse.frames", 0)
    if drawn is None:
        pictures = (draw(result.gaussians, path.select([index])).images[0, 0] for index in range(count))
        drawn = (to_bytes(picture) for picture in pictures)
    return path, list(track(drawn, "render camera path", count))


def _redrawn(
    gaussians: Gaussians, path: Cameras, rasterizer: Rasterizer, earlier: SceneState, draw: Render
) -> Iterator[Pixels] | None:
    """The pictures along the earlier run's path from those it left; None where that cannot be done exactly."""
    before = earlier_frames(earlier, identity(rasterizer))
    changed = changed_between(earlier.scene.gaussians.to(gaussians.means), gaussians) if before else None
    footprint = measured_footprint(rasterizer, gaussians.means) if changed is not None else None
    return redraw(before, changed, gaussians, path, footprint, draw) if footprint is not None else None


def _same(cameras: Cameras, other: Cameras | None) -> bool:
    """Whether the photos are placed alike, bit for bit."""
    same = other is not None and cameras.image_size == other.image_size
    return same and all(torch.equal(getattr(cameras, n).cpu(), getattr(other, n)) for n in ("c2w", "intrinsics"))


def _write_for_editing_again(
    folder: RunFolder,
    result: "RunResult",
    photos: LoadedPhotos,
    path: Cameras,
    rasterizer: Rasterizer,
    config: "RunConfig",
) -> None:
    if result.photos.images.shape[0] != 1:
        return
    frames = tuple(hash_of(frame_file(folder.renders, index).read_bytes()) for index in range(path.count))
    before = result.earlier.prompts if result.earlier is not None else ()
    used = set(result.photos.names)
    state = SceneState(
        photos=result.photos,
        edited=result.edited,
        scene=Reconstruction(result.whole, result.cameras),
        path=path,
        drawn=Drawn(result.gaussians is result.whole, identity(rasterizer), frames),
        prompts=(*before, config.prompt),
        records=tuple(photo for photo in photos.photos if photo.name in used),
        reconstructor=recorded(config.reconstructor),
    )
    note("reuse.edits", list(state.prompts))
    save_state(folder.root, state)
    result.memory.save(folder.root / FOLDER)


def _write_scene(folder: RunFolder, result: "RunResult") -> None:
    """`scene.ply` is for viewers, and common ones refuse harmonics above degree 3."""
    if result.gaussians.degree > VIEWER_DEGREE:
        warn(
            f"scene.ply holds harmonics up to degree {VIEWER_DEGREE} of {result.gaussians.degree}: viewers refuse more."
        )
    prompt = " ".join(result.request.prompt.split())
    save_ply(folder.scene, result.gaussians, degree=VIEWER_DEGREE, comment_lines=[f"prompt: {prompt}"])


def _write_pictures(folder: RunFolder, result: "RunResult", rendered: Rendering, frames: list[Pixels]) -> None:
    views = [result.photos.images[0].cpu(), result.edited.images[0].cpu(), rendered.images[0].clamp(0, 1).cpu()]
    jobs = [
        (to_bytes(picture), directory / f"{name}.png")
        for pictures, directory in zip(views, (folder.inputs, folder.edited, folder.renders))
        for name, picture in zip(result.photos.names, pictures)
    ]
    jobs += [(frame, frame_file(folder.renders, index)) for index, frame in enumerate(frames)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # coding runs outside the GIL
        list(pool.map(lambda job: save_pixels(*job), jobs))
    subtitle = f"editor {component_name(result.editor)}, reconstructor {component_name(result.reconstructor)}"
    title = result.request.prompt or "no prompt"
    save_before_after(folder.before_after, *views, names=result.photos.names, title=title, subtitle=subtitle)


def _manifest(
    result: "RunResult", photos: LoadedPhotos, masks: dict[str, str], rasterizer: Rasterizer, config: "RunConfig"
) -> RunManifest:
    report = result.report
    components = {"editor": result.editor, "reconstructor": result.reconstructor, "rasterizer": rasterizer}
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
    return (
        f"{result.gaussians.count:,} Gaussians from {result.photos.count} photos in {seconds:.1f} s\n"
        f"  look first   {folder.before_after}\n"
        f"  walk around  {folder.viewer} (opens in a browser, no network needed)\n"
        f"  scene        {folder.scene}\n"
        f"  how it was   {folder.manifest}"
    )
