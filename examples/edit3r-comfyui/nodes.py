"""The two nodes. ComfyUI's images are `[image, height, width, 3]` in [0, 1], masks `[image, height,
width]`, and its nodes run where PyTorch keeps no gradients, which refining a scene needs.
"""

import tempfile
from itertools import count
from pathlib import Path

import folder_paths  # of ComfyUI
import torch

import edit3r
from edit3r.contract.settings import of_file
from edit3r.kit.files.yaml import parse_yaml
from edit3r.kit.photos.cameras import read_scene_cameras
from edit3r.kit.photos.images import save_image
from edit3r.kit.rendering import path_around, render_each


class Edit3rEdit:
    """Edit a batch of photos of one place, and make them a scene."""

    CATEGORY = "edit3r"
    DESCRIPTION = "Edits two or more photos of one place as a sentence says, in 3D."
    FUNCTION = "edit"
    RETURN_TYPES = ("STRING", "IMAGE", "IMAGE", "STRING")
    RETURN_NAMES = ("scene", "edited", "rendered", "verdict")

    @classmethod
    def INPUT_TYPES(cls):
        return {
            "required": {
                "images": ("IMAGE", {"tooltip": "a batch of two or more photos"}),
                "prompt": ("STRING", {"multiline": True, "default": "make it warmer"}),
                "seed": ("INT", {"default": 0, "min": 0, "max": 2**31 - 1}),
            },
            "optional": {
                "mask": (
                    "MASK",
                    {
                        "tooltip": "where pixels may change: one a photo, or one of the "
                        "first photo, which is followed; empty: what the prompt names"
                    },
                ),
                "settings": (
                    "STRING",
                    {
                        "multiline": True,
                        "default": "",
                        "tooltip": "keywords of edit3r.run, a line each, such as 'size: 768'",
                    },
                ),
            },
        }

    def edit(self, images, prompt, seed, mask=None, settings=""):
        with tempfile.TemporaryDirectory() as scratch, torch.inference_mode(False):
            photos = _files(Path(scratch), "", images[..., :3].movedim(-1, 1))
            masks = None
            if mask is not None and mask.any():  # ComfyUI's empty mask is black
                shown = mask.reshape(-1, 1, *mask.shape[-2:]).expand(-1, 3, -1, -1)
                masks = _files(Path(scratch), "_mask", shown)
            result = edit3r.run(
                photos,
                prompt,
                masks=masks,
                seed=seed,
                # A workflow may be a stranger's: its settings name no program or address.
                **of_file(parse_yaml(settings) or {}),
            )
        output = Path(folder_paths.get_output_directory())
        folders = (output / f"edit3r-{number}" for number in count(1))
        folder = next(folder for folder in folders if not folder.exists())
        result.save(folder)
        verdict = f"scene: {result.verdict.label}, {result.verdict.reason}"
        if result.edit_verdict is not None:
            verdict += f"\nedit: {result.edit_verdict}"
        edited, rendered = result.edited.images, result.rendered.images
        return str(folder / "scene.ply"), _shown(edited), _shown(rendered), verdict


class Edit3rRender:
    """Frames of a camera that moves between and around the photos of a scene."""

    CATEGORY = "edit3r"
    DESCRIPTION = "Shows a scene of 'Edit3r edit' from a camera that moves around."
    FUNCTION = "render"
    RETURN_TYPES = ("IMAGE",)
    RETURN_NAMES = ("frames",)

    @classmethod
    def INPUT_TYPES(cls):
        return {
            "required": {
                "scene": ("STRING", {"forceInput": True}),
                "frames": ("INT", {"default": 36, "min": 2, "max": 2000}),
            }
        }

    def render(self, scene, frames):
        gaussians = edit3r.load_ply(scene, visible=True)
        cameras, _ = read_scene_cameras(Path(scene).with_name("cameras.json"))
        rasterizer = edit3r.build("rasterizer", "auto")
        views = render_each(rasterizer, gaussians, cameras, "views")
        path = path_around(cameras, views, frames)
        return (_shown(render_each(rasterizer, gaussians, path, "path").images),)


def _files(folder, end, images):
    """Write images `[image, 3, height, width]`; a mask's name begins with that of its photo."""
    files = [folder / f"{index:03}{end}.png" for index in range(len(images))]
    for file, image in zip(files, images):
        save_image(image.float().cpu(), file)
    return files


def _shown(images):
    """Images `[1, image, 3, height, width]` as ComfyUI has them."""
    return images[0].movedim(1, -1).clamp(0, 1).contiguous().cpu()
