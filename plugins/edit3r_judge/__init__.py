"""Critics: what can be measured of an edit and of a scene, without knowing what was meant."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_critics():
    return [
        Component(
            "limits",
            "edit3r_judge.critic:LimitsCritic",
            "signals of edit and scene, held to limits that were fitted to known ones",
        )
    ]
