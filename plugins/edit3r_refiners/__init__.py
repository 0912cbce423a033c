"""Steps after reconstruction: fewer Gaussians, sharper Gaussians, no floaters, and nothing changed
outside the masks.
"""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_refiners() -> list[Component]:
    return [
        Component(
            "simplify",
            "edit3r_refiners.simplify:SimplifyRefiner",
            "keeps only the Gaussians that the scene requires, or at most a number",
        ),
        Component(
            "refine",
            "edit3r_refiners.refine:RefineRefiner",
            "sharpens the Gaussians by photometric steps on the edited photos",
        ),
        Component(
            "clean",
            "edit3r_refiners.clean:CleanRefiner",
            "takes out floaters: what hangs before everything that the cameras see",
        ),
        Component(
            "keep-outside-mask",
            "edit3r_refiners.keep_outside_mask:KeepOutsideMask",
            "keeps what shows outside the masks as it was before the edit, bit for bit",
        ),
    ]


@hookimpl
def register_commands() -> list[Component]:
    return [
        Component(
            "simplify",
            "edit3r_refiners.command:SimplifyCommand",
            "a saved scene (3DGS PLY) with only the Gaussians it requires, or without floaters",
        )
    ]
