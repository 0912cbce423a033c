"""Many scenes with one command: `edit3r batch`."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_commands() -> list[Component]:
    return [
        Component(
            "batch",
            "edit3r_batch.command:BatchCommand",
            "run thousands of scenes, a job a line of a file",
        )
    ]
