"""Files of learned weights: safetensors, written whole or not at all, read without running code."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import safetensors
import safetensors.torch
from torch import Tensor, nn

from edit3r.contract.errors import InputError, RunError, one_line
from edit3r.kit.files.atomic import atomic_write

WEIGHTS = "weights.safetensors"
"""The best weights of a training, in its folder `best`."""


def save_weights(
    path: Path, weights: Mapping[str, Tensor], metadata: Mapping[str, str] | None = None
) -> None:
    """Write weights as safetensors, whole or not at all; raises RunError when the disk is full."""
    content = {name: tensor.detach().contiguous() for name, tensor in weights.items()}
    with whole_file(path, "the weights") as partial:
        safetensors.torch.save_file(
            content, partial, metadata=None if metadata is None else dict(metadata)
        )


def weights_file(path: str | Path) -> Path:
    """The file that is meant where the folder of a training, or its `best`, may be given."""
    place = Path(path)
    if not place.is_dir():
        return place
    usual = (place / WEIGHTS, place / "best" / WEIGHTS)
    return next((file for file in usual if file.is_file()), usual[0])


def load_weights(network: nn.Module, path: str | Path) -> None:
    """Fill `network` with trained weights: a safetensors file, or a training's folder.

    For the setting `weights` of any reconstructor. Raises InputError when there are none or they do
    not fit.
    """
    file = weights_file(path)
    if not file.is_file():
        raise InputError(
            f"{path}: no such weights; give a .safetensors file, or the folder of a training."
        )
    try:
        weights = safetensors.torch.load_file(file)
        if not all(bool(tensor.isfinite().all()) for tensor in weights.values()):
            raise RuntimeError("it holds values that are not finite")
        network.load_state_dict(weights)
    except (safetensors.SafetensorError, RuntimeError, OSError) as error:
        raise InputError(
            f"{file}: these weights do not fit this network ({one_line(error)})."
        ) from None


@contextmanager
def whole_file(path: Path, what: str, then: str = "") -> Iterator[Path]:
    """A temporary path that becomes `path`; a failure is a RunError with `what` and a way out."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as partial:
            yield partial
    except (OSError, RuntimeError, safetensors.SafetensorError) as error:
        raise RunError(
            f"{path}: {what} could not be written ({error}); free some disk space{then}."
        ) from error
