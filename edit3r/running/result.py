"""A finished run in memory, and what of it goes into its folder."""

import base64
import html
import io
import tempfile
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path

import torch
from PIL import Image

from edit3r.contract.component import component_name
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import (
    DRAWING,
    Editor,
    OtherCandidates,
    Rasterizer,
    Reconstructor,
    SceneToWrite,
    SecondLook,
    Selected,
    Writer,
)
from edit3r.contract.reporting import Report, collecting, note, say
from edit3r.contract.torch_state import in_usual_torch
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Rendering, Views
from edit3r.contract.verdicts import EditVerdict, SelectionVerdict, Verdict
from edit3r.kit import asking
from edit3r.kit.cache import Cache
from edit3r.kit.contact_sheet import (
    draw_sheet,
    images_of,
    outlined_views,
    with_candidates,
)
from edit3r.kit.files.atomic import atomic_folder
from edit3r.kit.geometry.harmonics import dc_to_colour
from edit3r.kit.photos.camera_files import posed_cameras, write_cameras
from edit3r.kit.rendering import Flight, path_around, render_each
from edit3r.kit.scenes.ply import save_ply
from edit3r.running.before import colours_before
from edit3r.running.components import Components
from edit3r.running.config import DEFAULTS, RunConfig
from edit3r.running.records import Inputs, Masks, Preview, Records, SelectedRegions
from edit3r.running.run_folder import (
    GIVEN_SCENE,
    SCALE,
    UP,
    UPRIGHT,
    VIEWS,
    EarlierRun,
    RunFolder,
    what_images_lack,
)
from edit3r.running.run_json import run_facts
from edit3r.running.scene_input import SceneInput
from edit3r.running.unit import Unit, unit_of_scene

FITS = 15.0
"""PSNR [dB] of a photo in the scene from which the camera path comes near it. No figure kept."""


@dataclass(frozen=True, repr=False)
class RunResult:
    """A finished run in memory: the records of its steps, and what made them.

    Its properties are in the unit of the given poses, its records in the run's own. In a notebook
    it shows the sheet and the viewer.
    """

    records: Records = field(repr=False)
    components: Components
    report: Report
    cache: Cache  # answers that a further run on the same photos need not compute again

    @property
    def config(self) -> RunConfig:
        return self.components.config

    @cached_property
    def _of_photos(self) -> Unit:
        """Back into the unit in which the photos' poses were given, or into metres."""
        inputs = self.records.inputs
        return inputs.unit.inverse.times(inputs.scale)

    @cached_property
    def _of_scene(self) -> Unit:
        """The same for the scene, if it was made on those poses, or from them."""
        inputs, scene = self.records.inputs, self.records.reconstructed.reconstruction
        refined = self.components.job.refine_poses
        unit = unit_of_scene(scene, inputs.photos, inputs.unit, refined)
        return unit.times(inputs.scale).upright(inputs.up)

    @cached_property
    def photos(self) -> Views:
        """The views that were used and placed, unedited."""
        return self._of_photos.views(self.records.inputs.photos)

    @cached_property
    def edited(self) -> Views:
        """The views after the 2D editor and the composite with the masks."""
        return self._of_photos.views(self.records.edit.views)

    @property
    def masks(self) -> Masks | None:
        """Where pixels might change; None: everywhere."""
        return self.records.reconstructed.masks

    @cached_property
    def gaussians(self) -> Gaussians:
        """The edited scene, in the frame of view 0, or turned upright (`up`)."""
        return self._of_scene.gaussians(self.records.gaussians)

    @cached_property
    def scene(self) -> Gaussians:
        """The edited scene; of a given one in its own frame and unit, with the bits it came with
        where nothing changed.
        """
        given, records = self.records.inputs.scene, self.records
        if given is None:
            return self.gaussians
        made = records.reconstructed.reconstruction
        return given.edited(made, records.gaussians)

    @cached_property
    def cameras(self) -> Cameras:
        """Poses of the input views in that frame, at the views' size."""
        cameras = self.records.reconstructed.cameras
        return self._of_scene.cameras(cameras.at(self.photos.image_size))

    @cached_property
    def rendered(self) -> Rendering:
        """The scene from the input views."""
        return self._of_scene.rendering(self.records.judged.rendered)

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
        return self.components.editor

    @property
    def reconstructor(self) -> Reconstructor:
        return self.components.reconstructor

    @property
    def rasterizer(self) -> Rasterizer:
        return self.components.rasterizer

    @in_usual_torch
    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write what `edit3r run` leaves into `folder`, which appears whole or not at all."""
        with atomic_folder(folder, overwrite) as root:
            write_result(root, self)
        return Path(folder)

    def as_earlier(self) -> EarlierRun:
        """This run as what a further edit starts from."""
        chosen = {
            kind: {"name": choice.name, **choice.settings}
            for kind, choice in (
                ("reconstructor", self.config.reconstructor),
                ("matcher", self.config.matcher),
            )
        }
        inputs = Inputs(
            photos=self.photos,
            start=self.edited,
            files=self.records.inputs.files,
            prompts=self.records.inputs.prompts,
            things=self.records.selection.things,
            before=Reconstruction(self.gaussians, self.cameras),
            scale=self.records.inputs.scale,
            up=self.records.inputs.up,
        ).unmeasured()
        settings = {"frames": self.config.frames, **chosen}
        return EarlierRun(inputs, settings, hid=bool(self.components.hiding))

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
        scene = f"{self.gaussians.count:,} Gaussians from {self.photos.count} photos"
        return f"RunResult({self.verdict.label}: {scene}, {self.config.prompt!r})"

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
    writers = [result.components.writer(name) for name in result.config.writers]
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
            note(VIEWS, what_images_lack(result.photos))
            note("edits", list(result.records.inputs.prompts))
            if result.records.inputs.scale != 1:
                note(SCALE, result.records.inputs.scale)
            if result.records.inputs.up is not None:
                note(UP, result.records.inputs.up)
    folder.write_manifest(run_facts(result.records, result.components, result.report))


def _shown(result: RunResult, what: str, folder: Path) -> Path:
    """The file in `folder` that the writer of the picture, or of the page, made."""
    writer = result.components.writer(DEFAULTS["shown"][what])
    _write_by([writer], folder, _scene(result))
    return folder / writer.offer.component.file_name()


def _write_by(writers: Iterable[Writer], root: Path, scene: SceneToWrite) -> None:
    for writer in writers:
        asking.write(writer, root / writer.offer.component.file_name(), scene)


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
        candidates=_other_candidates(result.records.selection.selected, result.photos),
        rendered=result.rendered,
        title=result.config.prompt,
        about=_about(result),
        up=None if result.records.inputs.up is None else UPRIGHT,
        unit="" if result.records.inputs.scale == 1 else "m",
        second_look=partial(_look_before, result),
        render=render,
        frames=flight,
    )


def _look_before(result: RunResult) -> SecondLook:
    corrected = result.records.corrected
    given = result.records.inputs.scene
    made = result.records.reconstructed.reconstruction
    kept = made.kept if result.records.gaussians is made.gaussians else None
    if given is not None and kept is not None:  # it is known
        colours = dc_to_colour(result.gaussians.harmonics[0, :, 0])
        before = given.views.scene.gaussians.harmonics[0, kept, 0]
        colours[: len(before)] = dc_to_colour(before)
        return SecondLook(colours)
    colours = colours_before(
        result.gaussians,
        result.cameras,
        corrected.photos,
        corrected.edited,
        result.rendered,
    )
    return SecondLook(colours)


def _flight(folder: RunFolder, result: RunResult) -> Flight:
    path = path_around(
        result.cameras.select(_good_views(result)),
        result.rendered,
        result.config.frames,
    )
    pictures = (
        folder.subfolder("renders") if "frames" in result.config.written else None
    )
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
    # It holds features of the photos as they were.
    if "cache" in wanted and not result.components.hiding:
        result.cache.save(folder.cache)
    if "images" in wanted:
        things = result.records.selection.things
        folder.write_images(result.photos, result.edited, result.rendered, things)
    if "scene" in wanted:
        names, prompt = result.photos.names, result.config.prompt
        given = result.records.inputs.scene
        if given is not None:
            _write_given(folder, result, given)
        else:
            folder.write_scene(result.gaussians, result.cameras, names, prompt)
    _write_by(writers, folder.root, _scene(result))


def _write_given(folder: RunFolder, result: RunResult, given: SceneInput) -> None:
    """The edited scene in the format that it came in, and the cameras in its frame."""
    made = result.records.reconstructed.reconstruction
    content = given.content(made, result.records.gaussians)
    file = folder.root / f"scene{given.suffix}"
    note(GIVEN_SCENE, file.name)
    writer = DEFAULTS["writer_of_format"].get(given.form)
    if content is not None:
        file.write_bytes(content)
    elif writer is None:
        save_ply(file, result.scene)
    else:
        told = f"{given.form} keeps its Gaussians together, so all of them were written anew"
        say("scene.rewritten", f"{told}, as exactly as it can")
        scene = SceneToWrite(result.scene)
        asking.write(result.components.writer(writer), file, scene)
    names = [f"inputs/{name}.png" for name in result.photos.names]
    own = given.cameras_in_own_frame(result.cameras)
    write_cameras(folder.cameras, posed_cameras(own, names))


def _about(result: RunResult) -> str:
    """Who made the scene, and the verdicts, in one line."""
    line = (
        f"editor {result.components.editor_names}, "
        f"reconstructor {component_name(result.reconstructor)}"
    )
    line += _answers(result.records.selection, result.edit_verdict)
    line += f"; scene: {result.verdict.label}"
    left_out = result.records.reconstructed.left_out
    if left_out is not None:
        line += f"; left out: {', '.join(left_out.names)}"
    return line


def preview_sheet(preview: Preview, prompt: str) -> Image.Image:
    """The sheet of what `edit3r.running.pipeline.preview` returns: photos with the outline of what
    is selected, and the 2D edit.
    """
    photos, masks = preview.inputs.photos, preview.selection.masks
    outlined = outlined_views(images_of(photos), None if masks is None else masks[0])
    columns = {"photo": outlined}
    verdict = None if preview.edit is None else preview.edit.verdict
    answers = _answers(preview.selection, verdict)
    if preview.edit is not None:
        columns["2D edit"] = images_of(preview.edit.views)
    sheet = draw_sheet(
        columns,
        names=photos.names,
        title=prompt or "no prompt",
        subtitle=f"preview: nothing is reconstructed yet{answers}",
    )
    candidates = _other_candidates(preview.selection.selected, photos)
    return with_candidates(sheet, candidates)


def _other_candidates(
    things: Sequence[Selected], photos: Views
) -> tuple[OtherCandidates, ...]:
    """What else words may mean, for those that were unsure."""
    candidates = []
    for selected in things:
        if selected.is_sure or len(selected.candidates) < 2:
            continue
        view = selected.candidates[0].view
        masks = {}
        for one in selected.candidates:
            taken = " (taken)" if one.number == selected.taken else ""
            masks[f"--candidate {one.number}{taken}"] = one.mask
        photo = images_of(photos)[view]
        candidates.append(OtherCandidates(photo, photos.names[view], masks))
    return tuple(candidates)


def _answers(selection: SelectedRegions, edit: EditVerdict | None) -> str:
    """What was selected and how the edit was carried out, in a few words; "" without them."""
    line = "" if selection.verdict is None else f"; selected: {selection.verdict.short}"
    if edit is None:
        return line
    asked = selection.verdict is not None and selection.verdict.label == "question"
    return f"{line}; edit: {edit.label}{' if it is the right thing' if asked else ''}"
