"""Read a network's sizes off the shapes of an official state dict."""

import re
from collections.abc import Mapping

from torch import Tensor

from edit3r.errors import InputError
from edit3r_model.checkpoints.loaded import NetworkConfig, PartConfig


def infer_config(state: Mapping[str, Tensor], source: str) -> NetworkConfig:
    """Sizes of the network that official tensors `state` belong to; heads are not among them (no shape shows them)."""
    try:
        return NetworkConfig(PartConfig("asymmetric-vit", _backbone(state)), PartConfig("dpt-gaussian", _head(state)))
    except KeyError as error:
        raise InputError(
            f"{source}: key {error.args[0]!r} is missing, so the network's sizes cannot be read off it; expected a "
            f"NoPoSplat or MASt3R checkpoint."
        ) from None


def _backbone(state: Mapping[str, Tensor]) -> dict:
    width, channels, patch = state["backbone.patch_embed.proj.weight"].shape[:3]
    settings = {
        "width": width,
        "depth": _count(state, r"backbone\.enc_blocks\.(\d+)\."),
        "mlp_width": state["backbone.enc_blocks.0.mlp.fc1.weight"].shape[0],
        "decoder_width": state["backbone.decoder_embed.weight"].shape[0],
        "decoder_depth": _count(state, r"backbone\.dec_blocks\.(\d+)\."),
        "decoder_mlp_width": state["backbone.dec_blocks.0.mlp.fc1.weight"].shape[0],
        "patch_size": patch,
    }
    if channels > 3:  # ray directions: 3, or (degree + 1)^2 harmonics of them
        degree = 0 if channels == 6 else round((channels - 3) ** 0.5) - 1
        return settings | {"intrinsics": "pixelwise", "intrinsics_degree": degree}
    return settings


def _head(state: Mapping[str, Tensor]) -> dict:
    dpt = "downstream_head1.dpt"
    settings = {
        "feature_width": state[f"{dpt}.scratch.refinenet1.out_conv.weight"].shape[0],
        "point_width": state[f"{dpt}.head.0.weight"].shape[0],
        "layer_widths": tuple(state[f"{dpt}.act_postprocess.{k}.0.weight"].shape[0] for k in range(4)),
    }
    attributes = state.get("gaussian_param_head.dpt.head.4.weight")
    if attributes is not None:
        settings["harmonics_degree"] = round(((attributes.shape[0] - 8) / 3) ** 0.5) - 1
    return settings


def _count(state: Mapping[str, Tensor], pattern: str) -> int:
    """One more than the highest block number."""
    numbers = [int(found[1]) for key in state if (found := re.match(pattern, key))]
    if not numbers:
        raise KeyError(pattern.replace("\\", "").replace("(d+)", "0"))
    return max(numbers) + 1
