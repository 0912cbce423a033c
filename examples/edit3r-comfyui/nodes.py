"""The two nodes. ComfyUI's images are `[image, height, width, 3]` in [0, 1], masks `[image, height,
width]`, and its nodes run where PyTorch keeps no gradients, which refining a scene needs.
"""

import tempfile
from itertools import count
from pathlib import Path

import folder_paths  # of ComfyUI
import torch

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.settings import of_file
from edit3r.kit.files.configs import parse_yaml
from edit3r.kit.photos.camera_files import read_scene_cameras
from edit3r.kit.photos.images import save_image
from edit3r.kit.rendering import path_around, render_each
from edit3r.running import RunConfig

OTHER_INPUTS = {"prompt", "seed"}
"""Settings of a run that are inputs of their own."""


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
            photos = _images("images", images, 4, "two or more photos")
            masks = None
            if mask is not None and mask.any():  # ComfyUI's empty mask is black
                masks = _masks(mask, photos)
            result = edit3r.run(
                _files(Path(scratch), "", photos[..., :3].movedim(-1, 1)),
                prompt,
                masks=None if masks is None else _files(Path(scratch), "_mask", masks),
                seed=seed,
                **_settings(settings),
            )
        output = Path(folder_paths.get_output_directory())
        folders = (output / f"edit3r-{number}" for number in count(1))
        folder = next(folder for folder in folders if not folder.exists())
        result.save(folder)
        answers = {"selected": result.selection_verdict, "edit": result.edit_verdict}
        lines = [f"{on}: {one}" for on, one in answers.items() if one is not None]
        scene = f"scene: {result.verdict.label}, {result.verdict.reason}"
        verdict = "\n".join([*lines, scene])
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
        if not Path(scene).is_file():
            raise InputError(f"scene: {scene!r} is no file; connect 'Edit3r edit'.")
        gaussians = edit3r.load_ply(scene, visible=True)
        cameras, _ = read_scene_cameras(Path(scene).with_name("cameras.json"))
        rasterizer = edit3r.build("rasterizer", "auto")
        views = render_each(rasterizer, gaussians, cameras, "views")
        path = path_around(cameras, views, frames)
        return (_shown(render_each(rasterizer, gaussians, path, "path").images),)


def _images(name, given, axes, expected):
    """What an input holds; raises InputError naming the input where that is no image."""
    is_tensor = isinstance(given, torch.Tensor) and given.ndim == axes and len(given)
    if not is_tensor or not torch.isfinite(given).all():
        held = list(given.shape) if isinstance(given, torch.Tensor) else type(given)
        raise InputError(f"{name}: expected {expected}, of finite numbers, got {held}.")
    return given


def _masks(mask, photos):
    """Masks as images `[image, 3, height, width]`."""
    shape = (-1, *mask.shape[-2:])
    mask = _images("mask", mask.reshape(shape), 3, "masks [image, height, width]")
    count, sides = len(photos), photos.shape[1:3]
    if len(mask) not in (1, count) or mask.shape[1:] != sides:
        raise InputError(
            f"mask: expected one, or one a photo ({count}), of {list(sides)} like the images, got "
            f"{list(mask.shape)}."
        )
    return mask[:, None].expand(-1, 3, -1, -1)


def _settings(text):
    """Keywords of `edit3r.run` that no other input gives; raises InputError for anything else."""
    try:
        content = parse_yaml(text) or {}
    except ValueError as error:
        raise InputError(f"settings: not YAML ({error}).") from None
    known = sorted(
        {*RunConfig.model_fields, "recon"} - {*OTHER_INPUTS, "reconstructor"}
    )
    if not isinstance(content, dict):
        raise InputError("settings: expected lines such as 'size: 768'.")
    for key in content:
        if key not in known:
            raise InputError(
                f"settings: {key!r} is none; there are {', '.join(known)}."
            )
    # A workflow may be a stranger's: its settings name no program or address.
    return of_file(content)


def _files(folder, end, images):
    """Write images `[image, 3, height, width]`; a mask's name begins with that of its photo."""
    files = [folder / f"{index:03}{end}.png" for index in range(len(images))]
    for file, image in zip(files, images):
        save_image(image.float().cpu(), file)
    return files


def _shown(images):
    """Images `[1, image, 3, height, width]` as ComfyUI has them."""
    return images[0].movedim(1, -1).clamp(0, 1).contiguous().cpu()
