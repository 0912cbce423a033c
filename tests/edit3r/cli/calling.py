"""A plugin for tests: whatever it offers calls a program when it is built."""

from pathlib import Path

from pydantic import Field

from edit3r import Component, hookimpl
from edit3r.contract.errors import RunError
from edit3r.contract.settings import USER_ONLY, Settings


@hookimpl
def register_editors():
    return Component("calling", "calling:Calling", "test stand-in: calls a program")


@hookimpl
def register_reconstructors():
    return Component("calling", "calling:Calling", "test stand-in: calls a program")


@hookimpl
def register_datasets():
    return Component("calling", "calling:Calling", "test stand-in: calls a program")


class Calling:
    class Settings(Settings):
        program: str = Field("", json_schema_extra=USER_ONLY)

    def __init__(self, settings):
        if settings.program:
            Path(settings.program).touch()
        raise RunError("called")
