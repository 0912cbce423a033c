"""Flags made from a settings class: one for each setting that a single word can give."""

import argparse
import types
import typing
from typing import Any

from pydantic.fields import FieldInfo

from edit3r.contract.settings import PartChoice, Settings
from edit3r.kit.command.flags import REPEATED
from edit3r.running.config import JobInputs, RunConfig

INPUTS = {name: field.description for name, field in JobInputs.model_fields.items()}
SHORT = {"reconstructor": "recon"}
"""Settings whose flag is not their own name."""
OUTLINE = ("larger", "grow", "invert", "candidate")
"""Settings that `add_mark_flags` has flags for."""


def add_flags(parser: argparse.ArgumentParser, cls: type[Settings]) -> None:
    """Add the flags of a settings class; none has a default, to tell what was said."""
    for name, field in cls.model_fields.items():
        form = _form(field)
        if form is None or name in OUTLINE:
            continue
        flag = f"--{SHORT.get(name, name).replace('_', '-')}"
        parser.add_argument(flag, dest=name, help=_help(field), **form)


def add_mark_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags that say which object is meant; `edit3r.running.selecting.marks` reads them."""
    add = parser.add_argument
    add("--point", metavar="[N:]X,Y", help=INPUTS["point"], **REPEATED)
    add("--not-point", metavar="[N:]X,Y", help=INPUTS["not_point"], **REPEATED)
    add("--stroke", metavar="[N:]X,Y,X,Y,...", help=INPUTS["stroke"], **REPEATED)
    add("--box", metavar="[N:]X,Y,W,H", help=INPUTS["box"], **REPEATED)
    add("--region", metavar="[N:]X,Y,W,H", help=INPUTS["region"], **REPEATED)
    add("--thing", metavar="TEXT", default="", help=INPUTS["thing"])
    add(
        "--mask",
        metavar="FILE",
        nargs="+",
        action="extend",
        default=[],
        help=INPUTS["mask"],
    )
    outline = RunConfig.model_fields
    larger = outline["larger"].description or ""
    add("--larger", action="append_const", const=1, help=larger)
    smaller = larger.replace("larger", "smaller")
    add("--smaller", action="append_const", const=-1, dest="larger", help=smaller)
    candidate = outline["candidate"].description
    add("--candidate", metavar="N", type=int, help=f"{candidate} (default 1)")
    grow = outline["grow"].description
    add("--grow", metavar="PIXELS", type=float, help=grow)
    add(
        "--invert", action="store_const", const=True, help=outline["invert"].description
    )


def given_flags(args: argparse.Namespace, cls: type[Settings]) -> dict[str, Any]:
    """The settings that were given as flags."""
    values = {name: getattr(args, name, None) for name in cls.model_fields}
    return {name: value for name, value in values.items() if value is not None}


def _help(field: FieldInfo) -> str:
    default = None if field.is_required() else field.default
    if isinstance(default, tuple):
        default = ",".join(map(str, default))
    if isinstance(default, PartChoice):
        default = default.name
    shown = "" if default in (None, "") else f" (default {default})"
    return f"{field.description}{shown}".replace("%", "%%")


def _form(field: FieldInfo) -> dict[str, Any] | None:
    """How argparse reads a setting of this type; pydantic checks the value itself.

    None: a list of components, which takes `--set` or a file.
    """
    kinds = _kinds(field)
    if any(PartChoice in typing.get_args(kind) for kind in kinds):
        return None
    words = [
        word for kind in kinds if _is_literal(kind) for word in typing.get_args(kind)
    ]
    if words and len(kinds) == 1:
        return {"choices": words}
    if words:
        return {"metavar": "|".join([*words, "N"])}
    if kinds == [bool]:
        return {"action": "store_const", "const": True}
    if PartChoice in kinds:
        return {"metavar": "NAME"}
    if kinds[0] in (int, float):
        return {"metavar": "N", "type": kinds[0]}
    return {"metavar": "TEXT"}


def _kinds(field: FieldInfo) -> list[Any]:
    """The types that a setting may have, without None."""
    annotation = field.annotation
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        options = typing.get_args(annotation)
    else:
        options = (annotation,)
    return [option for option in options if option is not type(None)]


def _is_literal(kind: Any) -> bool:
    return typing.get_origin(kind) is typing.Literal
