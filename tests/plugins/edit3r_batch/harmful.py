"""A plugin for tests: an editor that does what the prompt says, and writes down that it was
asked.
"""

import os
import time
from dataclasses import replace
from pathlib import Path

from edit3r import Component, hookimpl
from edit3r.contract.errors import RunError
from edit3r.contract.interfaces import Editor


@hookimpl
def register_editors():
    return Component(
        "harmful",
        "harmful:HarmfulEditor",
        "test stand-in: dies, fails, waits or inverts",
    )


class HarmfulEditor(Editor):
    def __init__(self, settings):
        self.settings = settings
        self.built = time.monotonic_ns()

    def edit(self, views, request):
        if log := os.environ.get("EDIT3R_TEST_LOG"):
            with Path(log).open("a") as file:
                file.write(f"{request.seed} {os.getpid()} {self.built}\n")
        if request.prompt == "die":
            os._exit(9)
        if request.prompt == "fail":
            raise RunError("the model | is\nnot in the mood.")
        if request.prompt == "crash":
            raise ZeroDivisionError("x / 0")
        if request.prompt == "wait":
            time.sleep(0.3)
        return replace(views, images=1 - views.images)
