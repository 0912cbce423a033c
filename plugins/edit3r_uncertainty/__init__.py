"""How much of a finished scene to trust, for each Gaussian: `edit3r uncertainty`."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_commands() -> list[Component]:
    return [
        Component(
            "uncertainty",
            "edit3r_uncertainty.command:UncertaintyCommand",
            "show which parts of a finished scene can be trusted in a new view",
        )
    ]
