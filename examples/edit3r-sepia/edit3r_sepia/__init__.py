"""Plugin sepia: only says what it offers; the editor's module loads when it is built."""

from edit3r import Component, hookimpl

EDIT3R_API = 1  # the interface version this was written for


@hookimpl
def register_editors():
    return [
        Component(
            "sepia",
            "edit3r_sepia.editor:SepiaEditor",
            "old photographs in sepia; reads no prompt",
            licence="Apache-2.0",
        )
    ]
