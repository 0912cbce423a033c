"""A server of the Model Context Protocol: an assistant selects, edits, looks and exports."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_commands() -> list[Component]:
    return [
        Component(
            "mcp",
            "edit3r_mcp.command:McpCommand",
            "let an assistant edit scenes: a server of the Model Context Protocol",
            requires=("mcp",),
            extra="mcp",
        )
    ]
