"""Files of settings, and settings given as `KEY=VALUE`. YAML may come from anybody: it is read
within bounds, and runs no code.
"""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml

from edit3r.contract.errors import InputError, SettingsError, did_you_mean, one_line
from edit3r.contract.settings import merge, of_file, shortened


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
        f"{name}: neither a file nor a shipped configuration."
        f"{did_you_mean(name, shipped)} Shipped: {listed}."
    )


def parse_assignments(assignments: Iterable[str]) -> dict[str, Any]:
    """`["editor.steps=20", ...]` to a nested mapping; see `_typed` for the values."""
    result: dict[str, Any] = {}
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        path = key.strip().split(".")
        if not equals or not all(path):
            raise SettingsError(
                f"--set {assignment}: expected KEY=VALUE, for example --set editor.seed=3."
            )
        value = _typed(text)
        for part in reversed(path):
            value = {part: value}
        result = merge(result, value)
    return result


_VALUE = re.compile(r"\s*([-+.\w]+|~|\[.*\]|\{.*\})\s*", re.DOTALL)
"""What may be more than a text where it was typed as a value."""


def _typed(text: str) -> Any:
    """A number, true, false, null, or a list or mapping in brackets, by YAML; else the text as it
    was typed, with all that YAML would take for a comment or a key.
    """
    try:
        value = parse_yaml(text) if _VALUE.fullmatch(text) else text
    except ValueError:
        return text
    return text if isinstance(value, str) else value


MAX_VALUES = 100_000
"""Values in a YAML document, those that aliases repeat counted each time."""


_TAG = "tag:yaml.org,2002:"


class _Loader(yaml.SafeLoader):
    """YAML without its guesses: 010, 1:05, 1_000, 2024-01-01 and yes are texts, of which a
    setting's type makes what they are.
    """

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012


_WHOLE = "(0|[1-9][0-9]*)"
for _name, _form, _starts in (
    ("bool", "true|True|TRUE|false|False|FALSE", "tTfF"),
    ("int", f"-?{_WHOLE}", "-0123456789"),
    (
        "float",
        rf"[-+]?({_WHOLE}?\.[0-9]+|{_WHOLE}\.)([eE][-+][0-9]+)?",
        "-+.0123456789",
    ),
    ("float", r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)", "-+."),
    ("null", "~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("merge", "<<", "<"),
):
    _Loader.add_implicit_resolver(
        f"{_TAG}{_name}", re.compile(f"({_form})$"), list(_starts)
    )


def read_yaml(path: str | Path) -> dict[str, Any]:
    """Read a YAML mapping; an empty file is an empty mapping."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such configuration file.")
    try:
        content = parse_yaml(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(f"{path}: not valid YAML ({error}).") from None
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise InputError(
            f"{path}: expected a mapping of settings at the top, got {type(content).__name__}."
        )
    return content


def parse_yaml(text: str) -> Any:
    """Read YAML that may come from anybody: numbers, texts, lists and mappings with text as keys.

    Raises ValueError with the reason for anything else: what is no YAML, dates that do not exist,
    numbers and nestings that Python refuses, keys that are no text or that stand twice, more than
    `MAX_VALUES` values.
    """
    try:
        loader = _Loader(text)
        document = loader.get_single_node()
        if document is None:
            return None
        _check_node(document, {})
        return loader.construct_document(document)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except (yaml.YAMLError, ValueError, OverflowError, TypeError) as error:
        raise ValueError(one_line(error)) from None


def _check_keys(keys: Iterable[yaml.Node]) -> None:
    """Refuse keys that are no text, and one that stands twice in its mapping."""
    lines: dict[str, int] = {}
    for key in keys:
        if key.tag not in (f"{_TAG}str", f"{_TAG}merge"):
            raise ValueError(
                f"the key {shortened(key.value)} is no text; put it in quotes"
            )
        line = key.start_mark.line + 1
        if key.value in lines:
            raise ValueError(
                f"line {line}: the key {shortened(key.value)} stands in line {lines[key.value]} too"
            )
        lines[key.value] = line


def _check_node(node: yaml.Node, counts: dict[yaml.Node, int]) -> int:
    """Count the values of a node, each alias as what it stands for; refuse keys that are no text.

    A node that several aliases name is visited once. `counts` holds what was visited.
    """
    if isinstance(node, yaml.ScalarNode):
        return 1
    if node not in counts:
        counts[node] = MAX_VALUES  # as long as it is not known: it may hold itself
        children = node.value
        if isinstance(node, yaml.MappingNode):
            _check_keys([key for key, _ in node.value])
            children = [value for _, value in node.value]
        counts[node] = 1 + sum(_check_node(child, counts) for child in children)
    if counts[node] > MAX_VALUES:
        raise ValueError(f"it holds more than {MAX_VALUES} values")
    return counts[node]
