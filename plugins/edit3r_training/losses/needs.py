"""Checks that a training step gives a loss what it compares."""

from edit3r.errors import SettingsError
from edit3r.interfaces import LossInputs


def require(inputs: LossInputs, loss: str, *names: str) -> None:
    """Raise SettingsError unless the fields `names` of `inputs` are there."""
    missing = [name for name in names if getattr(inputs, name) is None]
    if missing:
        raise SettingsError(
            f"loss {loss!r} compares {' and '.join(names)}, but this training step has no {missing[0]}; "
            "take the loss out of the configuration or use data that brings it (depths give a reference)."
        )
