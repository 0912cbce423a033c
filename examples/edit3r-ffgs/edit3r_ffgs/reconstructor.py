"""Reconstructor `ffgs`: Gaussians and cameras of unposed photos by a network of ffgs."""

import torch
from ffgs import GSPipeline, Views as FfgsViews, zoo
from ffgs.geometry import Similarity
from ffgs.registry import get_model_spec
from pydantic import Field
from safetensors.torch import load_file

import edit3r
from edit3r.contract.interfaces import Geometry, Reconstructor
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Views
from edit3r.kit.geometry.cameras import invert_rigid, relative_to_first
from edit3r.kit.weights.find import find
from edit3r_ffgs import ANYSPLAT


class FfgsReconstructor(Reconstructor):
    """Sees the middle of each photo that fits the network's input, and no more; its unit of length
    is its own.
    """

    class Settings(edit3r.Settings):
        model: str = Field(
            "",
            description="folder that GSPipeline.save_pretrained wrote; empty: AnySplat's weights",
        )

    settings: Settings

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.pipeline = (
            GSPipeline.from_pretrained(settings.model)
            if settings.model
            else _anysplat()
        )

    def __call__(
        self,
        views: Views,
        source: Views | None = None,
        geometry: Geometry | None = None,
        grid: tuple[int, int] | None = None,
    ) -> Reconstruction:
        pipeline = self.pipeline.to(views.images.device)
        scenes = [
            _in_frame_of_view_0(pipeline(FfgsViews(images)), views.image_size)
            for images in views.images
        ]
        gaussians, cameras = zip(*scenes)
        c2w, intrinsics = (
            torch.cat([getattr(one, name) for one in cameras])
            for name in ("c2w", "intrinsics")
        )
        return Reconstruction(
            Gaussians.stack(gaussians), Cameras(c2w, intrinsics, views.image_size)
        )


def _anysplat() -> GSPipeline:
    """AnySplat from the file that `edit3r weights get anysplat` fetched; raises with that line
    where it is missing.
    """
    file, entry = find(ANYSPLAT), zoo.get_entry("anysplat/default")
    spec = get_model_spec(entry.model_type)
    network = spec.model_cls(**entry.model)
    network.load_state_dict(spec.convert_state_dict(load_file(file)))
    return GSPipeline(
        network, spec.processor_cls.from_dict(entry.processor), entry.model_type
    )


def _in_frame_of_view_0(
    output, image_size: tuple[int, int]
) -> tuple[Gaussians, Cameras]:
    """Turn what ffgs answers for one scene, in the network's frame, into edit3r's Gaussians and
    cameras.
    """
    w2c = invert_rigid(output.cameras.c2w[:, 0].float())
    moved = Similarity(w2c[:, :3, :3], torch.ones(1), w2c[:, :3, 3]).apply(
        output.gaussians
    )
    quats = torch.nn.functional.normalize(moved.quats, dim=-1)
    gaussians = Gaussians(moved.means, moved.scales, quats, moved.opacities, moved.sh())
    # ffgs cut the middle out of each photo; its lens is that of the cut, ours that of the whole
    # photo.
    (height, width), (high, wide) = image_size, output.cameras.image_shape
    scale = max(high / height, wide / width)
    intrinsics = output.cameras.normalized_k.clone()
    intrinsics[..., 0, 0] *= wide / (scale * width)
    intrinsics[..., 1, 1] *= high / (scale * height)
    return gaussians, Cameras(
        relative_to_first(output.cameras.c2w.float()), intrinsics, image_size
    )
