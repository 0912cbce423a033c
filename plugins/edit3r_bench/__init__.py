"""The editing benchmark of the paper: its builder, its runner, its measures and its report."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_commands() -> Component:
    return Component(
        "bench",
        "edit3r_bench.command:BenchCommand",
        "the editing benchmark: build its items, run methods on them, report the results",
    )
