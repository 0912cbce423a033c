"""The app: photos, a click on the object, a sentence, and before and after in 3D, in the
browser.
"""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_commands() -> list[Component]:
    return [
        Component(
            "app",
            "edit3r_app.command:AppCommand",
            "edit in the browser: click the object, say what to change, see before and after in 3D",
            requires=("starlette", "uvicorn"),
            extra="app",
        )
    ]
