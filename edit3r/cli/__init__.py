"""The command line: one file a command, each a `Command` like those that plugins bring."""

from edit3r.contract.component import Component

COMMANDS = (
    Component(
        "run",
        "edit3r.cli.run:RunCommand",
        "edit photos of a scene and reconstruct them in 3D",
    ),
    Component(
        "render",
        "edit3r.cli.render:RenderCommand",
        "pictures, a video and a viewer page from a saved scene (3DGS PLY)",
    ),
    Component(
        "list-plugins",
        "edit3r.cli.list_plugins:ListPluginsCommand",
        "list installed plugins and their components, what they lack, and which failed and why",
    ),
    Component(
        "describe",
        "edit3r.cli.describe:DescribeCommand",
        "show a component's settings, licence and needs, and YAML to paste into a configuration",
    ),
    Component(
        "doctor",
        "edit3r.cli.doctor:DoctorCommand",
        "check versions, devices, memory, plugins and rasterizers, and run a tiny job",
    ),
    Component(
        "weights",
        "edit3r.cli.weights:WeightsCommand",
        "learned weights that components can load: list them with licences, fetch them, find them",
    ),
    Component(
        "new-plugin",
        "edit3r.cli.new_plugin:NewPluginCommand",
        "write a working plugin package to start from",
    ),
)
"""The core's own commands; all others come from plugins."""
