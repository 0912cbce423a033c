"""Files of settings, and settings given as `KEY=VALUE`."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from edit3r.contract.errors import InputError, SettingsError, suggest
from edit3r.contract.settings import merge, of_file
from edit3r.kit.files.yaml import parse_yaml, read_yaml


def read_config(name: str, trusted: bool) -> dict[str, Any]:
    """Read a configuration, see `find_config`.

    One that is not `trusted` gives no `USER_ONLY` setting.
    """
    content = read_yaml(find_config(name))
    return content if trusted else of_file(content)


def find_config(name: str) -> Path:
    """Path of a configuration: a file, or the name of a shipped one (without `.yaml`)."""
    given = Path(name)
    if given.is_file():
        return given
    # The checkout comes first: an editable install leaves a stale copy of configs/ inside the
    # package.
    package = Path(__file__).parents[2]
    folders = (package.parent / "configs", package / "configs")
    folder = next(filter(Path.is_dir, folders), folders[0])
    shipped = {
        file.relative_to(folder).with_suffix("").as_posix(): file
        for file in sorted(folder.rglob("*.yaml"))
    }
    if name in shipped:
        return shipped[name]
    listed = ", ".join(shipped) or "none"
    raise InputError(
        f"{name}: neither a file nor a shipped configuration.{suggest(name, shipped)} Shipped: "
        f"{listed}."
    )


def parse_assignments(assignments: Iterable[str]) -> dict[str, Any]:
    """`["editor.steps=20", ...]` to a nested mapping; values are read as YAML."""
    result: dict[str, Any] = {}
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        path = key.strip().split(".")
        if not equals or not all(path):
            raise SettingsError(
                f"--set {assignment}: expected KEY=VALUE, for example --set editor.seed=3."
            )
        try:
            value = parse_yaml(text)
        except ValueError:
            value = text
        for part in reversed(path):
            value = {part: value}
        result = merge(result, value)
    return result
