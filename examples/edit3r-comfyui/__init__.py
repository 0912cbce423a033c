"""Nodes of edit3r for ComfyUI: photos are edited as a sentence says, and become a scene in 3D."""

from .nodes import Edit3rEdit, Edit3rRender

NODE_CLASS_MAPPINGS = {"Edit3rEdit": Edit3rEdit, "Edit3rRender": Edit3rRender}
NODE_DISPLAY_NAME_MAPPINGS = {
    "Edit3rEdit": "Edit3r edit",
    "Edit3rRender": "Edit3r render",
}
__all__ = ["NODE_CLASS_MAPPINGS", "NODE_DISPLAY_NAME_MAPPINGS"]
