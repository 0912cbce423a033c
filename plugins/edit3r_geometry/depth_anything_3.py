"""The matcher `da3`: poses, field of view and depths by Depth Anything 3 (Lin et al. 2025), all
views in one pass.
"""

import math
import warnings
from typing import Literal

import numpy as np
import safetensors.torch
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

import edit3r
from edit3r.contract import reporting
from edit3r.contract.errors import InputError, MatchingError, one_line
from edit3r.contract.interfaces import Geometry, Matcher
from edit3r.contract.types import Views
from edit3r.contract.weights import Weights
from edit3r.kit.cache import remembered
from edit3r.kit.checks import require_matchable
from edit3r.kit.compute.perceptual import IMAGENET_MEAN, IMAGENET_STD
from edit3r.kit.files.names import expanded
from edit3r.kit.geometry.cameras import from_pixels, invert_rigid, relative_to_first
from edit3r.kit.geometry.maps import resize, size_of
from edit3r.kit.weights.find import find, record_of
from edit3r.kit.weights.load import out_of_memory_told
from edit3r_geometry import DEPTH_ANYTHING_3
from edit3r_geometry.upsampling import upsample_depth

PATCH = 14
"""Sides of the images the network sees are multiples of this [pixels]."""
MIN_SIZE = 32
"""Images with a shorter side show too little [pixels]."""
FLAT = 0.005
"""An image whose contrast (standard deviation) is below this shows nothing to match [sRGB].
No figure kept.
"""
NARROWEST = 3.0
"""A field of view below this was not read, and the given one stays [degrees]. No figure kept."""
OTHER_LENS = 0.1
"""Relative difference of focal lengths worth a warning. No figure kept."""


class DepthAnything3Matcher(Matcher):
    """One transformer for all views; it places every view, so photos of different scenes are not
    noticed.

    The unit of length is the network's own. Its confidence c > 1 becomes 1 - 1/c, which is 0.5 at c
    = 2.
    """

    class Settings(edit3r.Settings):
        model: Literal["da3-small", "da3-base"] = "da3-small"
        """34 or 135 million parameters"""
        weights: str = ""
        """its model.safetensors; empty: as fetched; 'untrained': random ones"""
        network_size: int = Field(504, ge=56, le=2016)
        """longer side of the images it looks at [pixels]"""

    settings: Settings

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._network = _load(settings.model, settings.weights)

    @torch.no_grad()
    @remembered
    def match(self, views: Views) -> Geometry:
        require_matchable(views, MIN_SIZE)
        images = views.images.float()
        if float(images.std((2, 3, 4)).amin()) < FLAT:
            raise MatchingError(
                "a photo shows nothing but one colour, so it cannot be placed."
            )
        small = resize(
            images, _network_size(views.image_size, self.settings.network_size)
        )
        mean, std = (
            small.new_tensor(values)[:, None, None]
            for values in (IMAGENET_MEAN, IMAGENET_STD)
        )
        network = self._network.to(small.device)
        with out_of_memory_told(
            "geometry", "try a smaller --set matcher.network_size, or fewer photos"
        ):
            found = [network((scene[None] - mean) / std) for scene in small]
        w2c, intrinsics, depths, trust = (
            torch.cat([scene[name] for scene in found])
            for name in ("extrinsics", "intrinsics", "depth", "depth_conf")
        )
        last_row = w2c.new_tensor([0, 0, 0, 1]).expand(*w2c.shape[:2], 1, 4)
        c2w = relative_to_first(invert_rigid(torch.cat((w2c[:, :, :3], last_row), 2)))
        depths, confidence = _at_full_size(depths, 1 - 1 / trust, small, images)
        placed = torch.ones(c2w.shape[:2], dtype=torch.bool, device=c2w.device)
        intrinsics = _lens(from_pixels(intrinsics, size_of(small)), views)
        c2w, depths, confidence = (
            x.to(views.images) for x in (c2w, depths, confidence)
        )
        return Geometry(c2w, depths, confidence, placed, intrinsics)


def _load(model: str, weights: str) -> nn.Module:
    """The network with its weights; raises MissingDependencyError with the way to them, InputError
    for other files.

    Its package builds networks from configuration files that may hold code, so only the package's
    own are read.
    """
    file = (
        None
        if weights == "untrained"
        else expanded(weights or find(_declared(model)) / "model.safetensors")
    )
    if file is not None and not file.is_file():
        raise InputError(
            f"matcher.weights: no file {str(file)!r}; give the model.safetensors of {model}."
        )
    network = _untrained(model)
    if file is not None:
        try:
            state = {
                name.removeprefix("model."): value
                for name, value in safetensors.torch.load_file(file).items()
            }
            missing, _ = network.load_state_dict(state, strict=False)
            # the head of rays is not used here
            if lacking := [name for name in missing if "_aux" not in name]:
                raise RuntimeError(f"it lacks {lacking[0]}")
        except (RuntimeError, safetensors.SafetensorError, OSError) as error:
            raise InputError(
                f"{file}: does not hold the weights of {model} ({one_line(error, 200)})."
            ) from None
        reporting.note(
            "matcher.weights",
            {"name": model, **record_of(file.parent)} if not weights else str(file),
        )
    return network.eval()


def _declared(model: str) -> Weights:
    return next(one for one in DEPTH_ANYTHING_3 if one.name == model)


def _untrained(model: str) -> nn.Module:
    """The network with random weights, always the same; its package is kept from talking."""
    with warnings.catch_warnings(), torch.random.fork_rng(devices=[]):
        warnings.simplefilter("ignore")
        from depth_anything_3.cfg import create_object, load_config
        from depth_anything_3.registry import MODEL_REGISTRY
        from depth_anything_3.utils.logger import logger
        from omegaconf import OmegaConf

        # it would evaluate what any configuration file of this process says
        OmegaConf.clear_resolver("eval")
        logger.level = 0
        torch.manual_seed(0)
        return create_object(load_config(MODEL_REGISTRY[model]))


def _network_size(image_size: tuple[int, int], longest: int) -> tuple[int, int]:
    """(height, width) like the image's, the longer side at most `longest`, multiples of PATCH."""
    scale = longest / max(image_size)
    height, width = (PATCH * max(2, round(side * scale / PATCH)) for side in image_size)
    return height, width


def _at_full_size(
    depths: Float[Tensor, "batch view h w"],
    confidence: Float[Tensor, "batch view h w"],
    small: Float[Tensor, "batch view 3 h w"],
    images: Float[Tensor, "batch view 3 height width"],
) -> tuple[
    Float[Tensor, "batch view height width"], Float[Tensor, "batch view height width"]
]:
    """Depth and confidence of every pixel of the images, carried there along their edges."""
    guides, large = (
        x.flatten(0, 1).permute(0, 2, 3, 1).contiguous().cpu().numpy()
        for x in (small, images)
    )
    maps = (
        (1 / depths).flatten(0, 1).cpu().numpy(),
        confidence.flatten(0, 1).cpu().numpy(),
    )
    fine = (
        torch.from_numpy(np.stack(x))
        for x in zip(*map(upsample_depth, *maps, guides, large))
    )
    inverse, trust = (x.to(images.device).unflatten(0, images.shape[:2]) for x in fine)
    return 1 / inverse, trust


def _lens(
    read: Float[Tensor, "batch view 3 3"], views: Views
) -> Float[Tensor, "batch view 3 3"]:
    """The intrinsics that the network read, with its depths; the given ones where it read none."""
    focal, given = (x[..., (0, 1), (0, 1)].amax(-1) for x in (read, views.intrinsics))
    unread = focal > 0.5 / math.tan(math.radians(NARROWEST) / 2)
    known = torch.tensor(
        [not assumed for assumed in views.assumed] or [True] * views.count,
        device=focal.device,
    )
    reporting.note(
        "matcher.fov",
        round(math.degrees(2 * math.atan(0.5 / float(read[0, 0, 0, 0]))), 1),
    )
    if bool(unread.any()):
        reporting.warn(
            "Depth Anything 3 read no field of view from some photos; the given one is kept there."
        )
    elif bool((((focal / given).log().abs() > OTHER_LENS) & known).any()):
        reporting.warn(
            "Depth Anything 3 sees another field of view than the photos tell; its depths go "
            "with its own."
        )
    return torch.where(
        unread[..., None, None], views.intrinsics, read.to(views.intrinsics)
    )
