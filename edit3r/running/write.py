"""What a run leaves behind: its result in memory, and one folder of files people can open. The
names of its own are those of `edit3r.kit.run_folder`; all others are made by writers.
"""

import base64
import html
import io
import os
import tempfile
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import torch
from PIL import Image

from edit3r.contract.component import component_name
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import (
    DRAWING,
    Editor,
    OtherReadings,
    Rasterizer,
    Reading,
    Reconstructor,
    SceneToWrite,
    SecondLook,
    Selected,
    Writer,
)
from edit3r.contract.reporting import Report, collecting, note, warn
from edit3r.contract.torch_state import in_usual_torch
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Rendering, Views
from edit3r.contract.verdicts import EditVerdict, SelectionVerdict, Verdict
from edit3r.kit.cache import Cache
from edit3r.kit.checks import check_needs, check_written, errors_named_after
from edit3r.kit.contact_sheet import (
    draw_sheet,
    images_of,
    outlined_views,
    with_readings,
)
from edit3r.kit.files.atomic import atomic_folder
from edit3r.kit.photos.cameras import posed_cameras, write_cameras
from edit3r.kit.photos.images import save_image, save_pixels, to_bytes
from edit3r.kit.rendering import Flight, path_around, render_each
from edit3r.kit.run_folder import (
    PluginRecord,
    RunFolder,
    RunManifest,
    WeightsRecord,
    write_manifest,
)
from edit3r.kit.scenes.ply import VIEWER_DEGREE, save_ply
from edit3r.running.before import colours_before
from edit3r.running.config import DEFAULTS, RunConfig
from edit3r.running.earlier import CACHE, THINGS, EarlierRun, note_views
from edit3r.running.parts import Parts
from edit3r.running.records import Masks, Preview, Records, SelectedRegions

FITS = 15.0
"""PSNR [dB] of a photo in the scene from which the camera path comes near it."""


@dataclass(frozen=True, repr=False)
class RunResult:
    """A finished run in memory: the records of its steps, and what made them.

    In a notebook it shows the sheet and the viewer.
    """

    records: Records = field(repr=False)
    parts: Parts
    report: Report
    cache: Cache  # answers that a further run on the same photos need not compute again

    @property
    def config(self) -> RunConfig:
        return self.parts.config

    @property
    def photos(self) -> Views:
        """The views that were used and placed, unedited."""
        return self.records.inputs.photos

    @property
    def edited(self) -> Views:
        """The views after the 2D editor and the composite with the masks."""
        return self.records.edit.views

    @property
    def masks(self) -> Masks | None:
        """Where pixels might change; None: everywhere."""
        return self.records.made.masks

    @property
    def gaussians(self) -> Gaussians:
        """The edited scene, in the frame of view 0."""
        return self.records.gaussians

    @property
    def cameras(self) -> Cameras:
        """Poses of the input views in that frame, at the views' size."""
        return self.records.made.cameras.at(self.photos.image_size)

    @property
    def rendered(self) -> Rendering:
        """The scene from the input views."""
        return self.records.judged.rendered

    @property
    def verdict(self) -> Verdict:
        """Whether the scene holds."""
        return self.records.judged.verdict

    @property
    def edit_verdict(self) -> EditVerdict | None:
        """How the edit was carried out on what was selected; None where none was asked for."""
        return self.records.judged.edit_verdict

    @property
    def selection_verdict(self) -> SelectionVerdict | None:
        """What was selected and how likely it is what was meant; None: nothing was looked for."""
        return self.records.selection.verdict

    @property
    def editor(self) -> Editor:
        return self.parts.editor

    @property
    def reconstructor(self) -> Reconstructor:
        return self.parts.reconstructor

    @property
    def rasterizer(self) -> Rasterizer:
        return self.parts.rasterizer

    @in_usual_torch
    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write what `edit3r run` leaves into `folder`, which appears whole or not at all."""
        with atomic_folder(folder, overwrite) as root:
            write_result(root, self)
        return Path(folder)

    def as_earlier(self) -> EarlierRun:
        """This run as what a further edit starts from."""
        choice, matcher = self.config.reconstructor, self.config.matcher
        return EarlierRun(
            photos=self.photos,
            edited=self.edited,
            scene=Reconstruction(self.gaussians, self.cameras),
            prompts=self.records.inputs.prompts,
            records=self.records.inputs.files,
            reconstructor={"name": choice.name, **choice.settings},
            matcher={"name": matcher.name, **matcher.settings},
            frames=self.config.frames,
            things=self.records.selection.things,
        )

    @in_usual_torch
    def view(self) -> Path:
        """Open the scene in the browser; returns the page, a temporary file."""
        import webbrowser

        page = _shown(self, "page", Path(tempfile.mkdtemp(prefix="edit3r-")))
        webbrowser.open(page.as_uri())
        return page

    @in_usual_torch
    def compare(self, other: "RunResult") -> Image.Image:
        """A sheet of the photos, this scene and an `other` of the same photos.

        Raises InputError for a result of other photos.
        """
        names = self.photos.names
        if other.photos.names != names:
            raise InputError(
                f"these are results of different photos: {', '.join(names)}, and "
                f"{', '.join(other.photos.names)}."
            )
        columns = {"photo": images_of(self.photos)}
        lines = []
        for each, name in ((self, "first"), (other, "second")):
            columns[name] = images_of(each.rendered)
            lines.append(f"{name}: {each.config.prompt} ({each.verdict.label})")
        return draw_sheet(columns, names=names, subtitle="; ".join(lines))

    def __repr__(self) -> str:
        made = f"{self.gaussians.count:,} Gaussians from {self.photos.count} photos"
        return f"RunResult({self.verdict.label}: {made}, {self.config.prompt!r})"

    @in_usual_torch
    def _repr_html_(self) -> str:
        """The sheet and the viewer as one piece of HTML that needs no other file."""
        with tempfile.TemporaryDirectory() as folder:
            picture, page = (
                _shown(self, what, Path(folder)) for what in ("picture", "page")
            )
            content = io.BytesIO()
            Image.open(picture, formats=("PNG",)).save(content, "WEBP", quality=85)
            text = html.escape(page.read_text(encoding="utf-8"))
        code = base64.b64encode(content.getvalue()).decode("ascii")
        return (
            f'<p>{html.escape(repr(self))}</p><img style="max-width:100%" '
            f'src="data:image/webp;base64,{code}">'
            f'<iframe style="width:100%;height:520px;border:0" srcdoc="{text}"></iframe>'
        )


def write_result(root: Path, result: RunResult) -> None:
    """Render and write what the run's `outputs` and `export` ask for into the existing folder
    `root`, and `run.json`.
    """
    folder, report = RunFolder(root), result.report
    writers = [result.parts.writer(name) for name in result.config.writers]
    drawing = [writer for writer in writers if {*writer.needs} & {*DRAWING}]
    others = [writer for writer in writers if writer not in drawing]
    with collecting(report), torch.no_grad():
        with report.stage("render"), ThreadPoolExecutor(1) as pool:
            # While frames are drawn, all else is written.
            rest = pool.submit(copy_context().run, _write_rest, folder, result, others)
            if drawing or "frames" in result.config.written:
                flight = _flight(folder, result)
                _write_by(drawing, folder.root, _scene(result, flight))
                flight.leave_pictures()
        with report.stage("write files"):
            rest.result()
            note_views(result.photos)
            note("edits", list(result.records.inputs.prompts))
    write_manifest(folder.manifest, _manifest(result))


def write_scene(writer: Writer, path: Path, scene: SceneToWrite) -> None:
    """Let a writer write `scene`, and hold it to its contract.

    Raises InputError for a scene that lacks what the writer needs, PluginError for a writer that
    fails.
    """
    check_needs(writer, scene)
    with errors_named_after(writer):
        writer.write(path, scene)
    check_written(writer, path)


def _shown(result: RunResult, what: str, folder: Path) -> Path:
    """The file in `folder` that the writer of the picture, or of the page, made."""
    writer = result.parts.writer(DEFAULTS["shown"][what])
    _write_by([writer], folder, _scene(result))
    return folder / writer.offer.component.file_name()


def _write_by(writers: Iterable[Writer], root: Path, scene: SceneToWrite) -> None:
    for writer in writers:
        write_scene(writer, root / writer.offer.component.file_name(), scene)


def _scene(result: RunResult, flight: Flight | None = None) -> SceneToWrite:
    """What is known of the scene; with `flight`, for writers that draw."""
    masks, render = result.masks, None
    if flight is not None:
        render = partial(
            render_each, result.rasterizer, result.gaussians, text="look at the scene"
        )
    return SceneToWrite(
        gaussians=result.gaussians,
        cameras=result.cameras,
        names=result.photos.names,
        photos=result.photos,
        edited=result.edited,
        masks=None if masks is None else masks[0],
        readings=_other_readings(result.records.selection.selected, result.photos),
        rendered=result.rendered,
        title=result.config.prompt,
        about=_about(result),
        second_look=partial(_look_before, result),
        render=render,
        frames=flight,
    )


def _look_before(result: RunResult) -> SecondLook:
    located = result.records.located
    photos = located.in_one_exposure(result.photos)
    edited = located.edited_in_one_exposure(result.edited)
    colours = colours_before(
        result.gaussians, result.cameras, photos, edited, result.rendered
    )
    return SecondLook(colours)


def _flight(folder: RunFolder, result: RunResult) -> Flight:
    path = path_around(
        result.cameras.select(_good_views(result)),
        result.rendered,
        result.config.frames,
    )
    pictures = folder.made("renders") if "frames" in result.config.written else None
    return Flight(result.rasterizer, result.gaussians, path, pictures)


def _good_views(result: RunResult) -> list[int]:
    """View 0 and the views whose photos fit the others; the camera path stays near these."""
    agreement = [psnr for psnr in result.verdict.agreement if psnr is not None]
    good = [view for view, psnr in enumerate(agreement) if view == 0 or psnr >= FITS]
    return good if len(good) > 1 else list(range(result.cameras.count))


@torch.no_grad()
def _write_rest(folder: RunFolder, result: RunResult, writers: list[Writer]) -> None:
    """Write the cache, images, masks and scene, then the files of the writers."""
    wanted = result.config.written
    if "cache" in wanted:
        result.cache.save(folder.root / CACHE)
    if "images" in wanted:
        _write_images(folder, result)
        _write_masks(folder, result)
    if "scene" in wanted:
        _write_scene(folder, result)
    _write_by(writers, folder.root, _scene(result))


def _write_scene(folder: RunFolder, result: RunResult) -> None:
    """`scene.ply` is for viewers, and common ones refuse harmonics above degree 3."""
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


def _write_images(folder: RunFolder, result: RunResult) -> None:
    """Write photos, 2D edits and the scene from the photos' places."""
    shown = {
        folder.made("inputs"): images_of(result.photos),
        folder.made("edited"): images_of(result.edited),
        folder.made("renders"): images_of(result.rendered),
    }
    jobs = [
        (picture, directory / f"{name}.png")
        for directory, pictures in shown.items()
        for name, picture in zip(result.photos.names, pictures)
    ]
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # coding runs outside the GIL
        list(pool.map(lambda job: save_image(*job), jobs))


def _write_masks(folder: RunFolder, result: RunResult) -> None:
    """Masks of what was named, which a further edit knows by these names."""
    things = result.records.selection.things
    for place, masks in enumerate(things.values()):
        masks_folder = folder.made("masks") / str(place)
        masks_folder.mkdir()
        for name, mask in zip(result.photos.names, masks):
            save_pixels(to_bytes(mask.expand(3, -1, -1)), masks_folder / f"{name}.png")
    if things:
        note(THINGS, list(things))


def _about(result: RunResult) -> str:
    """Who made the scene, and the verdicts, in one line."""
    line = (
        f"editor {result.parts.editor_names}, "
        f"reconstructor {component_name(result.reconstructor)}"
    )
    line += _answers(result.records.selection, result.edit_verdict)
    line += f"; scene: {result.verdict.label}"
    left_out = result.records.made.left_out
    if left_out is not None:
        line += f"; left out: {', '.join(left_out.names)}"
    return line


def preview_sheet(made: Preview, prompt: str) -> Image.Image:
    """The sheet of what `edit3r.running.loop.preview` returns: photos with the outline of what is
    selected, and the 2D edit.
    """
    photos, masks = made.inputs.photos, made.selection.masks
    outlined = outlined_views(images_of(photos), None if masks is None else masks[0])
    columns = {"photo": outlined}
    if made.edit is not None:
        columns["2D edit"] = images_of(made.edit.views)
    sheet = draw_sheet(
        columns,
        names=photos.names,
        title=prompt or "no prompt",
        subtitle=_preview_line(made),
    )
    readings = _other_readings(made.selection.selected, photos)
    return with_readings(sheet, readings)


def _other_readings(
    things: Sequence[Selected], photos: Views
) -> tuple[OtherReadings, ...]:
    """What else words may mean, for those that were unsure."""
    readings = []
    for selected in things:
        if selected.is_sure or len(selected.readings) < 2:
            continue
        view = selected.readings[0].view
        masks = {_chosen_by(one, selected): one.mask for one in selected.readings}
        photo = images_of(photos)[view]
        readings.append(OtherReadings(photo, photos.names[view], masks))
    return tuple(readings)


def _chosen_by(reading: Reading, selected: Selected) -> str:
    taken = " (taken)" if reading.number == selected.taken else ""
    return f"--reading {reading.number}{taken}"


def _preview_line(made: Preview) -> str:
    line = "preview: nothing is reconstructed yet"
    edit = None if made.edit is None else made.edit.verdict
    return line + _answers(made.selection, edit)


def _answers(selection: SelectedRegions, edit: EditVerdict | None) -> str:
    """What was selected and how the edit was carried out, in a few words; "" without them."""
    line = "" if selection.verdict is None else f"; selected: {selection.verdict.short}"
    if edit is None:
        return line
    asked = selection.verdict is not None and selection.verdict.label == "question"
    return f"{line}; edit: {edit.label}{' if it is the right thing' if asked else ''}"


def _manifest(result: RunResult) -> RunManifest:
    report, config = result.report, result.config
    components = {
        "editor": result.editor,
        **result.parts.geometry_parts,
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
        inputs=result.records.inputs.files,
        masks=result.records.inputs.mask_files,
        weights=[WeightsRecord(**facts) for facts in weights.values()],
        verdict=result.verdict,
        edit_verdict=result.edit_verdict,
        selection_verdict=result.selection_verdict,
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
