"""Plugin program: a reconstructor that is some other program."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_reconstructors():
    return [
        Component(
            "program",
            "edit3r_program.reconstructor:ProgramReconstructor",
            "runs a program of yours: photos in, scene.ply and cameras.json out",
            licence="Apache-2.0; that of the program is yours to look up",
            min_views=2,
        )
    ]
