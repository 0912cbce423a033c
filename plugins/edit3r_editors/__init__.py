"""Editors that need no learned weights: none at all, looks, retouching, a stand-in, images from
elsewhere, programs.
"""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_editors():
    return (
        Component(
            "none",
            "edit3r_editors.none:NoneEditor",
            "returns the photos as they are: reconstruction only",
        ),
        Component(
            "mock-diffusion",
            "edit3r_editors.mock_diffusion:MockDiffusionEditor",
            "stand-in for a diffusion editor: seeded colour and texture changes, understands no "
            "prompt",
        ),
        Component(
            "folder",
            "edit3r_editors.folder:FolderEditor",
            "takes pictures you edited elsewhere from a folder (editor.path)",
        ),
        Component(
            "command",
            "edit3r_editors.command:CommandEditor",
            "runs any program on the photos (editor.command)",
            supports_seed=False,
            licence="that of the program you name",
        ),
        Component(
            "retouch",
            "edit3r_editors.retouch:RetouchEditor",
            "removes what is masked and shows what the other photos see behind it; the rest is "
            "inpainted",
            parts=("matcher",),
            actions=("remove",),
            min_views=2,
        ),
        Component(
            "looks",
            "edit3r_editors.looks:LooksEditor",
            "a named look for the picture or what is masked (autumn, sketch, marble ...): "
            "filters, nothing generative",
            actions=("look", "paint"),
        ),
    )
