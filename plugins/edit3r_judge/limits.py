"""What was fitted: the limits of all signals."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from edit3r.kit.files.yaml import read_yaml

FITTED = Path(__file__).with_name("fitted.yaml")


@cache
def limits_of_edits() -> Mapping[str, float]:
    """By signal; see `fitted.yaml`."""
    return _read()["edit"]


@cache
def limits_of_scenes() -> Mapping[str, Mapping[str, float]]:
    """By label and signal; see `fitted.yaml`."""
    return _read()["scene"]


def _read() -> dict[str, Any]:
    return read_yaml(FITTED)
