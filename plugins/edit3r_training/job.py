"""From a training configuration to a trainer and its job, with everything built.

trainer: {name: recolor, steps: 1000}
reconstructor: {name: edit3r, weights: untrained}
reference: {name: noposplat, weights: runs/first/best}     # or absent
rasterizer: numba
train_data: {name: procedural, seed: 1}
validation_data: {name: procedural, seed: 2, scenes: 64}   # or absent
losses: {mse: {weight: 1.0}, center: {weight: 0.1, beta: 0.1}}
out: runs/edit
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from edit3r import Registry
from edit3r.contract.errors import InputError, SettingsError
from edit3r.contract.interfaces import Trainer, TrainingJob
from edit3r.contract.settings import (
    FileText,
    OfKind,
    PartChoice,
    Settings,
    make_settings,
)
from edit3r.kit.checks import require_gives
from edit3r.kit.weights.files import WEIGHTS
from edit3r.running import DEFAULTS
from edit3r_training.checkpoint import LAST
from edit3r_training.journal import LOG

_OF_A_TRAINING = (LAST, f"best/{WEIGHTS}", LOG)
"""What a training writes; it may also be a user's own."""


class TrainingConfig(Settings):
    """The keys of a training configuration file."""

    trainer: PartChoice = PartChoice(name=DEFAULTS["trainer"])
    """the recipe"""
    reconstructor: PartChoice
    """what is trained"""
    reference: Annotated[PartChoice | None, OfKind("reconstructor")] = None
    """frozen reconstructor, whose centres of the unedited photos the 3D losses hold to; default:
    the true surface where the data has depths, else what is trained as it is at the start
    """
    matcher: PartChoice = PartChoice.model_validate(DEFAULTS["matcher"])
    """reads the geometry of photos whose depth the data does not know"""
    rasterizer: PartChoice = PartChoice(name=DEFAULTS["training_rasterizer"])
    """renders during training"""
    train_data: Annotated[PartChoice, OfKind("dataset")]
    """dataset to train on"""
    validation_data: Annotated[PartChoice | None, OfKind("dataset")] = None
    """held-out dataset"""
    losses: Annotated[dict[str, dict[str, Any]], OfKind("loss")] = Field(
        default_factory=dict
    )
    """name: {weight, settings...}"""
    out: str = "runs/train"
    """folder for checkpoints, logs and sample sheets"""


def prepare(
    values: Mapping[str, Any],
    registry: Registry,
    resume: bool = False,
    overwrite: bool = False,
) -> tuple[Trainer, TrainingJob]:
    """Build every component that a configuration names.

    Raises InputError when the output folder holds another training and neither `resume` nor
    `overwrite` is set.
    """
    config = make_settings(TrainingConfig, values, where="training")
    _check_inside(values.get("out"))
    _check_free(Path(config.out), resume or overwrite)

    def build(kind: str, choice: PartChoice, where: str = "") -> Any:
        return registry.build_at(where or kind, kind, choice)

    validation, reference = config.validation_data, config.reference
    job = TrainingJob(
        reconstructor=build("reconstructor", config.reconstructor),
        matcher=build("matcher", config.matcher),
        rasterizer=build("rasterizer", config.rasterizer),
        train_data=build("dataset", config.train_data, "train_data"),
        validation_data=None
        if validation is None
        else build("dataset", validation, "validation_data"),
        losses={
            name: _loss(registry, name, given) for name, given in config.losses.items()
        },
        out=Path(config.out),
        resume=resume,
        reference=None
        if reference is None
        else build("reconstructor", reference, "reference"),
        config=config.model_dump(mode="json"),
    )
    require_gives(job.rasterizer, config.rasterizer.name, "images", who="training")
    return build("trainer", config.trainer), job


def _check_inside(out: object) -> None:
    """Raise InputError where a file that is not trusted says to write outside of this folder."""
    here = Path.cwd().resolve()
    if not isinstance(out, FileText) or here in (here / out).resolve().parents:
        return
    raise InputError(
        f"training.out: the file says {out}, which is outside the current folder; give --out a "
        "folder, or --trust-config."
    )


def _check_free(out: Path, may_hold_training: bool) -> None:
    """Raise InputError unless a training may write to `out`."""
    if out.exists() and not out.is_dir():
        raise InputError(
            f"{out}: --out must be a folder, but a file of that name exists."
        )
    held = next((name for name in _OF_A_TRAINING if (out / name).exists()), None)
    if held and not may_hold_training:
        on = "--resume to go on with it, " if (out / LAST).exists() else ""
        raise InputError(
            f"{out}: holds a training already ({held}); give {on}another --out to keep it, or "
            "--overwrite to begin anew in its place."
        )


def _loss(registry: Registry, name: str, given: Mapping[str, Any]) -> tuple[float, Any]:
    """Weight and loss from `{weight, settings...}`; the weight is 1 unless given."""
    settings = dict(given)
    weight = settings.pop("weight", 1.0)
    if not isinstance(weight, int | float) or isinstance(weight, bool) or weight < 0:
        raise SettingsError(
            f"training.losses.{name}.weight: expected a number of at least 0, got {weight!r}."
        )
    choice = PartChoice(name=name, settings=settings)
    return float(weight), registry.build_at(f"losses.{name}", "loss", choice)
