"""The core's own commands; all others come from plugins."""

from edit3r.contract.component import Component

COMMANDS = (
    Component(
        "run",
        "edit3r.cli.run:RunCommand",
        "edit photos of a scene and reconstruct them in 3D",
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
        "weights",
        "edit3r.cli.weights:WeightsCommand",
        "learned weights that components can load: list them with licences, fetch them, find them",
    ),
)
