"""Training plugin: the data, losses and recipe of the paper's recolor training."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_datasets() -> list[Component]:
    return [
        Component(
            name="procedural",
            target="edit3r_training.procedural_dataset:ProceduralDataset",
            summary="endless textured rooms and open grounds with exact poses, depth, masks and edited truth",
        ),
    ]
