"""Run one method through a benchmark: edit, reconstruct and render each item, measure it, and leave
its images.

What is killed at any moment leaves no result, only images that the next attempt overwrites.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Float
from pydantic import Field, field_validator, model_validator
from torch import Tensor

import edit3r
from edit3r.config import PartChoice, Settings, make_settings, merge
from edit3r.contract.interfaces import Editor
from edit3r.contract.types import Cameras, EditRequest
from edit3r.errors import (
    Edit3rError,
    InputError,
    MatchingError,
    PluginError,
    PromptError,
    RunError,
    SettingsError,
)
from edit3r.geometry.cameras import scale_poses
from edit3r.geometry.paths import between_and_around
from edit3r.io.images import save_image
from edit3r.io.run_folder import installed_versions
from edit3r.pipeline.rendering import render_each
from edit3r.pipeline.steps import composite
from edit3r.plugins.registry import Registry, default_registry
from edit3r.reporting import Report, StageRecord, collecting
from edit3r.workers import Progress, Workers, read_rows, run_resumable
from edit3r_measure.bench_manifest import (
    ItemRecord,
    LoadedItem,
    Manifest,
    load_item,
    read_bench_manifest,
)
from edit3r_measure.bench_metrics import (
    MethodOutput,
    MetricNetworks,
    MetricSettings,
    measure,
    measure_failure,
    remark,
    score,
)
from edit3r_measure.oracle import ORACLE, OracleEditor, OracleSettings
from edit3r_measure.report import make_folder, read_json, write_json

RESULTS = "results.jsonl"
RUN = "bench-run.json"
LABEL = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+-]*")

ONE_WORKER = Workers(threads=1)

# Errors that are a result of the method; any other ends the benchmark, since the wish itself was
# wrong
FAILURES = (MatchingError, PromptError, RunError, PluginError)


class Method(Settings):
    """One column of the comparison: an editor with a reconstructor, and how they are run."""

    label: str = Field(
        "",
        description="name of the column and of its folder; default: editor and reconstructor",
    )
    editor: PartChoice = Field(
        description="2D editor; default: 'oracle', the offline stand-in"
    )
    reconstructor: PartChoice = Field(description="reconstructor; default: edit3r")
    rasterizer: PartChoice = Field(
        description="draws the pictures that are measured; default: auto"
    )
    edit_views: Literal["all", "first"] = Field(
        "all", description="edit every view, or the reference only"
    )
    edit_renders: bool = Field(
        False,
        description="reconstruct the photos, and edit its renderings one by one: no edited scene "
        "is made",
    )
    gaussians_of: Literal["all", "first"] = Field(
        "all",
        description="first: show only those of the reference (single-view lifting)",
    )
    run: dict[str, Any] = Field(
        default_factory=dict, description="settings of the run, such as refine: 0"
    )
    poses: bool = Field(
        True,
        description="hand true poses to reconstructors that read them, where they are known",
    )
    truth: bool | None = Field(
        None,
        description="judge by the edited truth where it is known; default: for the oracle, whose "
        "edit it is",
    )
    note: str = Field(
        "", description="what a reader of the table must know about this column"
    )

    @field_validator("label")
    @classmethod
    def _usable_as_a_folder(cls, value: str) -> str:
        if value and not LABEL.fullmatch(value):
            raise ValueError(
                "must be letters, digits, blanks, dots, dashes, plus signs and underscores"
            )
        return value

    @model_validator(mode="before")
    @classmethod
    def _settings_without_a_name_are_of_the_default(cls, values: Any) -> Any:
        return merge(
            {"editor": ORACLE, "reconstructor": "edit3r", "rasterizer": "auto"}, values
        )

    @model_validator(mode="after")
    def _label_by_default(self) -> "Method":
        if not self.label:
            label = f"{self.editor.name}+{self.reconstructor.name}".replace(":", "-")
            object.__setattr__(
                self, "label", label
            )  # the class is frozen for everybody else
        return self


def read_methods(
    values: Mapping[str, Any], changes: Mapping[str, Mapping[str, Any]] | None = None
) -> tuple[Method, ...]:
    """Return the `methods` of a configuration; `changes` are settings by label. Labels must
    differ.
    """
    entries = values.get("methods")
    if set(values) - {"methods"} or not isinstance(entries, list) or not entries:
        raise SettingsError(
            "a benchmark configuration has one key, 'methods', with a list of at least one method."
        )
    methods = {}
    for index, entry in enumerate(entries):
        label = make_settings(Method, entry, where=f"methods.{index}").label
        if label in methods:
            raise SettingsError(
                f"methods: two are called {label!r}; give each its own label."
            )
        changed = merge(entry, (changes or {}).get(label, {}))
        methods[label] = make_settings(Method, {"label": label, **changed}, where=label)
    unknown = sorted(set(changes or {}) - set(methods))
    if unknown:
        raise SettingsError(
            f"--set {unknown[0]}: no such method in the configuration; it has {', '.join(methods)}."
        )
    return tuple(methods.values())


@dataclass(frozen=True)
class ItemResult:
    """What one edit gave; one line of `results.jsonl`."""

    id: str
    scene: str
    type: str
    metrics: Mapping[str, float]  # NaN where one means nothing
    failure: str = ""  # why the method gave nothing; "" when it did
    timing: Mapping[str, Any] | None = (
        None  # as `timing_of` tells it; None after a failure
    )
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def remark(self) -> str:
        """That the edit changed nothing, in words; "" when it did or failed."""
        return "" if self.failure else remark(self.metrics)


def read_results(folder: Path) -> dict[str, ItemResult]:
    """Return the results of a folder by item id."""
    return {
        name: _result_of_row(row)
        for name, row in read_rows(folder / RESULTS, "id").items()
    }


def _result_of_row(row: Mapping[str, Any]) -> ItemResult:
    """Return the result that a line of `results.jsonl` holds, the score among its metrics."""
    metrics = {
        name: math.nan if value is None else value
        for name, value in row["metrics"].items()
    }
    return ItemResult(
        **{**row, "metrics": {**metrics, "score": score(metrics, row["failure"])}}
    )


@dataclass(frozen=True)
class BenchRun:
    """A method on its way through a manifest: turns an item into a row of results; pickled to each
    worker.
    """

    manifest_file: Path
    method: Method
    out: Path
    metrics: MetricSettings = field(default_factory=MetricSettings)
    scenes: int | None = None  # only the first
    edits: int | None = None  # only the first of each scene
    plugins: tuple[str, ...] = ()  # local plugin files
    every_error: bool = False  # that a user could cause is a result too
    position: int = 0  # of the method's column in reports
    _built: dict[str, Any] = field(default_factory=dict)

    @cached_property
    def registry(self) -> Registry:
        """The installed components and those of the local plugin files."""
        return default_registry(self.plugins)

    @cached_property
    def manifest(self) -> Manifest:
        """The part of the manifest that is asked for."""
        return read_bench_manifest(self.manifest_file).limited(self.scenes, self.edits)

    @cached_property
    def networks(self) -> MetricNetworks:
        """What the metrics need."""
        return MetricNetworks(self.metrics, self.registry)

    def __call__(self, record: ItemRecord) -> dict[str, Any]:
        """Do one item; a failure of the method is a result, with its sentence."""
        networks = (
            self.networks
        )  # first of all: what is missing shall not be told after minutes
        item = load_item(
            self.manifest, record, self.manifest_file.parent, self.registry
        )
        cold = self._built.setdefault("first item", record.id) == record.id
        named, report = (record.id, record.scene, record.type), Report()
        failures = (Edit3rError,) if self.every_error else FAILURES
        try:
            with collecting(report), torch.no_grad():
                output, facts = self._edit_and_render(item, report)
        except failures as error:
            return asdict(
                ItemResult(
                    *named,
                    measure_failure(item, self._has_truth(item), networks),
                    str(error),
                )
            )
        metrics = measure(item, output, networks)
        save_strips(self.out / "pictures" / record.id, item, output)
        return asdict(
            ItemResult(*named, metrics, "", timing_of(report.stages, cold), facts)
        )

    def _has_truth(self, item: LoadedItem) -> bool:
        """Whether the item's truth is what the method is judged by."""
        wished = (
            self.method.editor.name == ORACLE
            if self.method.truth is None
            else self.method.truth
        )
        return wished and item.truth is not None

    def _edit_and_render(
        self, item: LoadedItem, report: Report
    ) -> tuple[MethodOutput, dict[str, Any]]:
        method = self.method
        editor = "none" if method.edit_renders else self._editor(item, item.truth)
        output, count = self._reconstruct(item, editor, range(item.inputs), report)
        if method.edit_renders:
            with report.stage("edit (the renderings)"):
                images = self._edit_each(item, output.images)
            output = replace(output, images=images, edited=images[: item.inputs])
        elif item.inputs > 2:
            # The other inputs come the other way round, with the same 2D edits: the reconstruction
            # alone is asked.
            order = [0, *range(item.inputs - 1, 0, -1)]
            replayed = OracleEditor(
                output.edited[order], OracleSettings(disagreement=0)
            )
            images = self._reconstruct(item, replayed, order, Report())[0].images
            # Between predicted cameras, where no pose is known, the held-back frames would not
            # compare.
            reordered = images[
                [
                    0,
                    *(
                        range(item.inputs, len(images))
                        if item.cameras is not None
                        else ()
                    ),
                ]
            ]
            output = replace(output, reordered=reordered)
        return output, {"gaussians": count, "warnings": report.warnings}

    def _reconstruct(
        self,
        item: LoadedItem,
        editor: Editor | PartChoice | str,
        order: Sequence[int],
        report: Report,
    ) -> tuple[MethodOutput, int]:
        """Edit and reconstruct the inputs in this order; return what the scene shows and its number
        of Gaussians.
        """
        method, views = self.method, item.photos.select(order)
        if method.poses and item.cameras is not None:
            views = replace(views, c2w=item.cameras.c2w[:, list(order)])
        result = edit3r.run(
            views,
            item.record.prompt,
            editor=editor,
            recon=self._component("reconstructor", method.reconstructor),
            masks=None if item.masks is None else item.masks[None, list(order)],
            edit_views=method.edit_views,
            seed=item.record.seed,
            registry=self.registry,
            report=report,
            **method.run,
        )
        cameras = evaluation_cameras(item, result.cameras)
        gaussians = (
            result.gaussians.from_view(0)
            if method.gaussians_of == "first"
            else result.gaussians
        )
        rasterizer = self._component("rasterizer", method.rasterizer)
        with report.stage("render"):
            rendering = render_each(rasterizer, gaussians, cameras, "render")
        images, depths = rendering.images[0].clamp(0, 1), rendering.depths[0, :, 0]
        return MethodOutput(
            images, result.edited.images[0], depths, cameras, self._has_truth(item)
        ), gaussians.count

    def _edit_each(
        self, item: LoadedItem, images: Float[Tensor, "frame 3 height width"]
    ) -> Float[Tensor, "frame 3 height width"]:
        """Edit renderings instead of photos; what a mask leaves out stays. The oracle adds the true
        change.
        """
        truth = (
            None
            if item.truth is None
            else (images + item.truth - item.photos.images[0]).clamp(0, 1)
        )
        masks = None if item.masks is None else item.masks[None].nan_to_num(1.0)
        request = EditRequest(item.record.prompt, item.record.seed, masks)
        edited = (
            self._editor(item, truth)
            .edit(replace(item.photos, images=images[None]), request)
            .images
        )
        return edited[0] if masks is None else composite(images[None], edited, masks)[0]

    def _editor(
        self, item: LoadedItem, truth: Float[Tensor, "frame 3 height width"] | None
    ) -> Editor | PartChoice:
        editor = self.method.editor
        if editor.name != ORACLE:
            return self._component("editor", editor)
        if truth is None:
            raise InputError(
                f"{item.record.id}: the editor 'oracle' needs scenes whose edited truth is known."
            )
        return OracleEditor(
            truth, make_settings(OracleSettings, editor.settings, where="editor")
        )

    def _component(self, kind: str, choice: PartChoice) -> Any:
        """Build a component once; a reconstructor that edits is built by the run, with each item's
        editor.
        """
        if "editor" in self.registry.find(kind, choice.name).component.parts:
            return choice
        if kind not in self._built:
            self._built[kind] = self.registry.build(
                kind, choice.name, **choice.settings
            )
        return self._built[kind]


def run_bench(
    run: BenchRun,
    workers: Workers = ONE_WORKER,
    on_done: Callable[[Progress], None] = lambda progress: None,
) -> dict[str, ItemResult]:
    """Do the items that are not done yet; return all results in the manifest's order, the same for
    any workers.

    Raises InputError when `run.out` holds results of another manifest or method.
    """
    if not run.manifest.items:
        raise InputError(
            f"{run.manifest_file}: no edit is left to do with these limits."
        )
    _claim_folder(run, workers.threads)
    jobs = {item.id: item for item in run.manifest.items}
    rows = run_resumable(
        jobs, run, run.out / RESULTS, workers=workers, key_name="id", on_done=on_done
    )
    return {name: _result_of_row(row) for name, row in rows.items()}


def _claim_folder(run: BenchRun, threads: int | None) -> None:
    """Write what this folder's results are of, or refuse one that holds others."""
    whole = read_bench_manifest(run.manifest_file)
    asked = {
        "format": "edit3r-bench-run",
        "manifest": whole.name,
        "manifest_sha256": whole.sha256,
        "method": run.method.model_dump(mode="json"),
        "instruments": run.metrics.model_dump(mode="json"),
        "threads": threads,
    }
    path = make_folder(run.out) / RUN
    if path.is_file():
        found = read_json(path)
        for key in asked:
            if key in found and asked[key] != found[key]:
                what = key.replace("_", " ")
                raise InputError(
                    f"{run.out}: holds results with another {what}; choose another --out."
                )
        return
    if any(
        not path.name.startswith(".") for path in run.out.iterdir()
    ):  # a kill may leave a hidden half of ours
        raise InputError(
            f"{run.out}: holds files that are not of a benchmark run; choose another --out."
        )
    write_json(
        path, {**asked, "position": run.position, "versions": installed_versions()}
    )


def timing_of(stages: Sequence[StageRecord], cold: bool) -> dict[str, Any]:
    """Return wall and CPU seconds (`_cpu`) of one edit: `editor`, `network` (the reconstructor),
    `rendering`.

    Reading, building (loading weights), measuring and writing are in none. A cold edit is the first
    of its process.
    """
    parts = {"editor": "edit (", "network": "reconstruct (", "rendering": "render"}
    wall, cpu = {}, {}
    for name, start in parts.items():
        own = [stage for stage in stages if stage.name.startswith(start)]
        wall[name] = sum(stage.seconds for stage in own)
        cpu[f"{name}_cpu"] = sum(stage.cpu_seconds for stage in own)
    return {"cold": cold, **wall, **cpu}


def evaluation_cameras(item: LoadedItem, predicted: Cameras) -> Cameras:
    """Return the inputs' predicted cameras, then the held-back frames at their true places relative
    to the reference.

    In the unit that makes the inputs' mean distance from it the true one; between the inputs where
    no pose is known.
    """
    more, known = len(item.record.held_back), predicted.intrinsics
    if item.cameras is None:
        path = between_and_around(predicted, 2 * (more + 1)).select(range(1, more + 1))
        c2w, intrinsics = path.c2w, path.intrinsics
    else:
        true = item.cameras.c2w.to(known)
        lengths = [
            c2w[:, 1 : item.inputs, :3, 3].norm(dim=-1).mean()
            for c2w in (predicted.c2w, true)
        ]
        held_back = scale_poses(
            true[:, item.inputs :], lengths[0] / lengths[1].clamp(min=1e-12)
        )
        c2w, intrinsics = (
            predicted.c2w[:, :1] @ held_back,
            item.cameras.intrinsics[:, item.inputs :],
        )
    both = ((predicted.c2w, c2w), (known, intrinsics))
    return Cameras(
        *(torch.cat((own, added.to(known)), 1) for own, added in both),
        predicted.image_size,
    )


def save_strips(folder: Path, item: LoadedItem, output: MethodOutput) -> None:
    """Write one strip of frames each for the photos, the 2D edits, what the method shows, and the
    truth.
    """
    folder.mkdir(parents=True, exist_ok=True)
    strips = {
        "photos": item.photos.images[0],
        "edited": output.edited,
        "shown": output.images,
    }
    if output.has_truth:
        strips["truth"] = item.truth
    for name, images in strips.items():
        save_image(torch.cat(list(images), -1), folder / f"{name}.png")
