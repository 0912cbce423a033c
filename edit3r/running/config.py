"""What one run is asked to do, merged from a preset, a YAML file, `--set` and flags."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, WithJsonSchema, field_validator, model_validator

from edit3r.contract.component import component_name
from edit3r.contract.errors import SettingsError, UnknownComponentError
from edit3r.contract.settings import (
    OfKind,
    PartChoice,
    Settings,
    Share,
    make_settings,
    merge,
)
from edit3r.kit.files.configs import read_yaml
from edit3r.loading.registry import Registry

DEFAULTS = read_yaml(Path(__file__).with_name("defaults.yaml"))

MAX_PROMPT = 10_000  # characters: no instruction is longer, and reading it stays quick
MAX_STEPS = 9  # from one candidate to the next
MAX_GROWTH = 200.0  # of an outline [pixels]; a sanity limit
OWN_OUTPUTS = {
    "scene": ("scene.ply", "cameras.json"),
    "images": ("inputs", "edited", "renders", "masks"),
    "cache": ("cache",),
    "frames": ("renders",),
}
"""What a run writes by itself, and the files and folders of each; all else is made by writers."""
USUAL_OUTPUTS: tuple[str, ...] = tuple(DEFAULTS["outputs"])
Written = Annotated[
    tuple[str, ...],
    WithJsonSchema(
        {"type": ["array", "string"], "items": {"type": ["string", "object"]}}
    ),
]
"""Names of writers in a list, some with settings, or in one text with commas."""

PART_KEYS = (
    "reader",
    "editor",
    "matcher",
    "reconstructor",
    "rasterizer",
    "selector",
    "segmenter",
    "critic",
)


class RunConfig(Settings):
    """Settings of a run itself. Each is also a flag of `edit3r run`."""

    prompt: str = Field("", max_length=MAX_PROMPT)
    """what to change, such as 'paint the bike red'"""
    reader: PartChoice = PartChoice(name=DEFAULTS["reader"])
    """what reads the prompt, and its settings"""
    editor: PartChoice | None = None
    """2D editor and its settings; default: the one that can do what the prompt asks"""
    reconstructor: PartChoice = PartChoice(name=DEFAULTS["reconstructor"])
    """reconstructor and its settings"""
    matcher: PartChoice = PartChoice.model_validate(DEFAULTS["matcher"])
    """what finds poses and depths in the photos where they are needed; if --cameras has all poses,
    they are used as they are unless a matcher is named"""
    rasterizer: PartChoice = PartChoice(name=DEFAULTS["rasterizer"])
    """rasterizer and its settings"""
    selector: PartChoice = PartChoice(name=DEFAULTS["selector"])
    """what finds the marked or named thing on all photos, and its settings"""
    critic: PartChoice = PartChoice(name=DEFAULTS["critic"])
    """what judges the edit and the scene, and its settings"""
    segmenter: PartChoice | None = None
    """what outlines the thing that is marked or named; default: the editor's own"""
    guess: bool = False
    """go on with the likeliest candidate even where words hardly tell which thing is meant, instead
    of asking"""
    candidate: int = Field(1, ge=1, le=MAX_STEPS)
    """which candidate for the clicks, strokes, boxes or words is taken: 1 is the likeliest"""
    larger: int = Field(0, ge=-MAX_STEPS, le=MAX_STEPS)
    """take the next larger candidate; repeatable"""
    grow: float = Field(0.0, ge=-MAX_GROWTH, le=MAX_GROWTH)
    """move the outline of what is selected outwards [pixels]; inwards if negative"""
    invert: bool = False
    """change everything but the selection"""
    refiners: tuple[PartChoice, ...] = tuple(
        PartChoice(name=name) for name in DEFAULTS["refiners"]
    )
    """steps after reconstruction, in order; --gaussians and --refine add theirs before them"""
    edit_views: Literal["all", "first"] = "all"
    """edit every view, or the first only (as in training) and let the reconstructor carry it
    over"""
    strength: Share = 1.0
    """how much of the 2D edit is taken: 0 leaves the photos as they are, 1 takes all of it"""
    feather: float = Field(0.0, ge=0, le=MAX_GROWTH)
    """how far inside the outline of what is selected the edit fades in [pixels]"""
    moved_edits: Literal["undo", "keep"] = "undo"
    """undo: an edited picture that is shifted, zoomed, turned or mirrored against its photo is
    moved back; keep: it is taken as it is"""
    seed: int = Field(0, ge=0, lt=2**31)
    """one seed for all views"""
    size: int = Field(512, ge=8, le=8192)
    """longer side that photos are reduced to [pixels]"""
    fov: float | None = Field(None, gt=1, lt=170)
    """horizontal field of view [degrees] of photos that do not record it"""
    measure: str | None = None
    """a length that you know between two places of a photo, such as 1:120,80,1:400,80=1.2m (m, cm,
    mm, ft, in): the scene is then in metres"""
    views: int | None = Field(None, ge=2)
    """use at most this many photos, those that together show most; default: all (of a video, 8
    frames); of a scene, so many pictures of it (default 8)"""
    up: str | None = None
    """what points up. Of photos: three places on a floor or a table, such as
    1:120,380,1:400,350,1:300,420, or found (as the photos were held); files of the scene then stand
    upright. Of a given scene: its axis +x, -x, +y, -y, +z or -z; default: as its floor tells, else
    -y"""
    device: str = "cpu"
    """torch device of the learned parts, such as cpu or cuda"""
    frames: int = Field(36, ge=2, le=2000)
    """frames of the camera path between and around the input views"""
    outputs: Written = Field(
        USUAL_OUTPUTS,
        description=f"what is written beside run.json: some of {','.join(OWN_OUTPUTS)} and of the "
        "writers (edit3r list-plugins --kind writer); all: the usual ones and frames",
    )
    export: Written = ()
    """what else is written, by any writer, such as spz,glb"""
    writer: Annotated[dict[str, dict[str, Any]], OfKind("writer")] = Field({})
    """settings of writers by their names, such as writer.video.fps=30; in a list of outputs also
    {name: video, fps: 30}"""
    gaussians: int | Literal["all", "auto"] = "auto"
    """all, auto (only what the scene requires), or a number, at most (see docs/simplify.md)"""
    max_gaussians: int | None = Field(None, ge=1)
    """never keep more Gaussians than this"""
    refine: int = Field(12, ge=0, le=10000)
    """photometric steps at most, each towards one edited view"""
    grid: float = Field(0.67, gt=0, le=1)
    """size at which Gaussians are made, one for each pixel, as a share of the photos' size, where
    --refine follows and brings back the detail; 1: the photos' full size"""
    exposure: Literal["one", "own"] = "one"
    """one: photos that differ in exposure or white balance are brought to those of the first; own:
    each is taken as it is"""
    quality: Literal["fast", "balanced", "best"] | None = None
    """measured preset, which all other settings override (see docs/tradeoff.md)"""

    @model_validator(mode="before")
    @classmethod
    def _read_settings_of_outputs(cls, values: Any) -> Any:
        """Accept outputs with settings, `{name: video, fps: 30}`; those in `writer` win."""
        settings: dict[str, Any] = {}
        changed = dict(values)
        for key in ("outputs", "export"):
            given = values.get(key)
            if not isinstance(given, list | tuple):
                continue
            choices = [PartChoice.model_validate(one) for one in given]
            changed[key] = [one.name for one in choices]
            settings |= {one.name: one.settings for one in choices if one.settings}
        if settings:
            changed["writer"] = merge(settings, values.get("writer", {}))
        return changed

    @field_validator("outputs", "export", mode="before")
    @classmethod
    def _read_list(cls, value: Any) -> Any:
        """Accept names in one text with commas; whether there are such is asked later."""
        if isinstance(value, str):
            value = [name.strip() for name in value.split(",") if name.strip()]
        return (*USUAL_OUTPUTS, "frames") if value == ["all"] else value

    @field_validator("larger", mode="before")
    @classmethod
    def _read_steps(cls, value: Any) -> Any:
        """Accept the steps of --larger and --smaller one by one."""
        steps = isinstance(value, list) and all(isinstance(one, int) for one in value)
        return sum(value) if steps else value

    @field_validator("gaussians", mode="before")
    @classmethod
    def _read_gaussians(cls, value: Any) -> Any:
        """Accept a number given as text, and refuse one below 1."""
        if isinstance(value, str) and value.lstrip("-").isdigit():
            value = int(value)
        is_count = isinstance(value, int) and not isinstance(value, bool) and value >= 1
        if value not in ("all", "auto") and not is_count:
            raise ValueError("expected all, auto, or a number of at least 1")
        return value

    @property
    def written(self) -> tuple[str, ...]:
        """All that is written beside run.json, each once."""
        return tuple(dict.fromkeys((*self.outputs, *self.export)))

    @property
    def writers(self) -> tuple[str, ...]:
        """Names of the writers whose files are in `written`; the others the run makes itself."""
        return tuple(name for name in self.written if name not in OWN_OUTPUTS)

    def writer_choice(self, name: str) -> PartChoice:
        """The writer `name` with its settings, which stand under `writer.NAME`."""
        return PartChoice(name=name, settings=self.writer.get(name, {}))

    def all_refiners(self, by_default: bool = True) -> tuple[PartChoice, ...]:
        """The refiners in order: what `gaussians` and `refine` stand for, then those listed.

        A refiner that is listed as well keeps its place in the list. Not `by_default`: `gaussians`
        and `refine` count only where the user set them.
        """
        implied = self._implied_refiners(by_default)
        listed = [
            PartChoice(
                name=choice.name,
                settings={**implied.pop(choice.name, {}), **choice.settings},
            )
            for choice in self.refiners
        ]
        first = [
            PartChoice(name=name, settings=values) for name, values in implied.items()
        ]
        return (*first, *listed)

    def _implied_refiners(self, by_default: bool) -> dict[str, dict[str, Any]]:
        """Name and settings of the refiners that `gaussians` and `refine` stand for."""
        names = DEFAULTS["shorthands"]
        implied: dict[str, dict[str, Any]] = {}
        asked = self.set_by_the_user()
        fewer_asked = by_default or asked & {"gaussians", "max_gaussians"}
        if fewer_asked and (self.gaussians != "all" or self.max_gaussians is not None):
            fewer: dict[str, Any] = {"gaussians": self.gaussians}
            if self.max_gaussians is not None:
                fewer["max_gaussians"] = self.max_gaussians
            if self.refine:
                fewer |= names["gaussians_before_refine"]
            implied[names["gaussians"]] = fewer
        if self.refine and (by_default or "refine" in asked):
            implied[names["refine"]] = {"steps": self.refine}
        return implied

    def set_by_the_user(self) -> set[str]:
        """Names of the settings that were given, other than by the preset."""
        preset: Mapping[str, Any] = {}
        if self.quality is not None:
            from edit3r.running.quality import preset_point

            preset = preset_point(self.quality)["settings"]
        given = self.model_fields_set
        return {name for name in given if getattr(self, name) != preset.get(name)}


PLACES = ("mask", "point", "not_point", "box", "stroke", "region")
"""Inputs that say where on the photos, of which there may be several."""


class JobInputs(Settings):
    """What a run works on, in words: flags of `edit3r run`, keys of a line of `edit3r batch`."""

    photos: tuple[str, ...] = ()
    """photos, folders or videos of one scene; or a scene itself: .ply, .spz, .sog, .splat, .glb"""
    earlier: str | None = None
    """edit the scene of an earlier run again (its --out folder)"""
    cameras: str | None = None
    """cameras.json or transforms.json with the photos' intrinsics; 'none': ignore even one
    beside the photos"""
    refine_poses: bool = False
    """refine the given poses by bundle adjustment"""
    mask: tuple[str, ...] = ()
    """a mask for each photo, or a folder of them, named after the photos; or a single one, which is
    carried to the other photos; white is the object"""
    point: tuple[str, ...] = ()
    """a point on the object, on the first photo or photo N; repeatable"""
    not_point: tuple[str, ...] = ()
    """a point that is not on the object; repeatable"""
    box: tuple[str, ...] = ()
    """a box around the object, on the first photo or photo N"""

    stroke: tuple[str, ...] = ()
    """a line drawn over the object, on the first photo or photo N; repeatable"""
    region: tuple[str, ...] = ()
    """a box that is taken exactly as it is, on the first photo or photo N"""
    thing: str = ""
    """the object in words, such as 'the left cup', instead of marks"""

    @field_validator("photos", *PLACES, mode="before")
    @classmethod
    def _one_is_a_list(cls, value: Any) -> Any:
        return [value] if isinstance(value, str) else value


def make_run_config(*layers: Mapping[str, Any]) -> RunConfig:
    """Merge layers, later over earlier, and validate.

    A component may be given by name alone in any layer. The settings of a preset (`quality`) lie
    under all layers.
    """
    merged: dict[str, Any] = {}
    for layer in layers:
        merged = merge(
            merged, {key: _named(key, value) for key, value in layer.items()}
        )
    if merged.get("quality") is not None:
        from edit3r.running.quality import with_quality

        merged = with_quality(merged)
    for key in PART_KEYS:
        given = merged.get(key)
        has_default = isinstance(RunConfig.model_fields[key].default, PartChoice)
        if isinstance(given, dict) and "name" not in given and not has_default:
            merged[key] = {"name": _default_name(key), **given}
    return make_settings(RunConfig, merged, where="run")


def _default_name(key: str) -> str:
    """The component whose settings are meant where none is named."""
    if key == "editor":
        raise SettingsError(
            "run.editor: settings were given, but no editor, and the prompt decides which one is "
            f"used; name it too, such as --editor {DEFAULTS[key]}."
        )
    return DEFAULTS[key]


def _named(key: str, value: Any) -> Any:
    return {"name": value} if key in PART_KEYS and isinstance(value, str) else value


def check_components(
    config: RunConfig, registry: Registry, given: Mapping[str, Any] | None = None
) -> None:
    """Raise for unknown names and settings and for missing packages; `given` ones are built."""
    for kind in PART_KEYS:
        choice = getattr(config, kind)
        if choice is None or kind in (given or {}):
            continue
        if choice == RunConfig.model_fields[kind].default and not registry.missing(
            registry.find(kind, choice.name)
        ):
            continue  # its module loads when it is built, which some runs never do
        registry.check(kind, choice)
    for choice in config.all_refiners():
        registry.check("refiner", choice)
    _check_rasterizer(config, registry, given or {})
    _check_outputs(config, registry)


def _check_rasterizer(
    config: RunConfig, registry: Registry, given: Mapping[str, Any]
) -> None:
    """Raise for a rasterizer that does not give what a run needs."""
    # torch comes with them, which reading a configuration does without
    from edit3r.contract.types import RENDERED
    from edit3r.kit.checks import require_gives

    name, rasterizer = config.rasterizer.name, given.get("rasterizer")
    if rasterizer is None:
        rasterizer = registry.load_class(registry.find("rasterizer", name))
    else:
        name = component_name(rasterizer)
    require_gives(rasterizer, name, *RENDERED, who="a run")


def _check_outputs(config: RunConfig, registry: Registry) -> None:
    """Raise for an output that nobody writes, and for two that would be one file."""
    for name in config.writer:
        if name not in config.writers:
            written = ", ".join(config.writers) or "none"
            raise SettingsError(
                f"writer.{name}: nothing is written by {name!r} in this run; add it to outputs or "
                f"export. Writers of this run: {written}."
            )
    taken = {"run.json": "every run"}
    for name in config.written:
        taken |= dict.fromkeys(OWN_OUTPUTS.get(name, ()), name)
    for name in config.writers:
        try:
            registry.check("writer", config.writer_choice(name))
        except UnknownComponentError as error:
            of_runs = ", ".join(OWN_OUTPUTS)
            raise UnknownComponentError(
                f"outputs: {error} The run itself writes {of_runs}."
            ) from None
        file = registry.find("writer", name).component.file_name()
        if file in taken:
            raise SettingsError(
                f"outputs: {name} and {taken[file]} both write {file}; leave one of them out."
            )
        taken[file] = name
