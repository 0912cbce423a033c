"""What is on this machine, and plugins: `doctor`, `weights`, `new-plugin`, `plugins`."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_commands() -> list[Component]:
    return [
        Component(
            "doctor",
            "edit3r_develop.doctor:DoctorCommand",
            "check versions, devices, memory, plugins and rasterizers, and run a tiny job",
        ),
        Component(
            "weights",
            "edit3r_develop.weights:WeightsCommand",
            "learned weights that components can load: list them with licences, fetch them, find "
            "them",
        ),
        Component(
            "new-plugin",
            "edit3r_develop.new_plugin:NewPluginCommand",
            "write a working plugin package to start from",
        ),
        Component(
            "plugins",
            "edit3r_develop.plugins:PluginsCommand",
            "list plugins that others published, and how to install them",
        ),
    ]
