"""Official checkpoints: NoPoSplat's Lightning `.ckpt` and MASt3R's `.pth`, read without running any
code in them.

Official names are those of the published `re10k.ckpt` without its `encoder.` prefix. One of our
parameters may be several of theirs joined along the first axis, and one of theirs may be saved
under two names.
"""

import argparse
import pickle
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.settings import PartChoice

PREFIX = "encoder."
DRAWN = {"mast3r": ("backbone.intrinsics_embed.", "head.attributes.")}
"""What MASt3R does not have: as in the published recipe these parts start from random weights."""
EMPTY = {"seed": None}
"""Settings of a part that waits for its weights: nothing is drawn, no memory is taken."""
LICENCES = {
    "noposplat": "not stated in the file; the published NoPoSplat weights start from MASt3R's, "
    "which are CC BY-NC-SA "
    "4.0 (non-commercial)",
    "mast3r": "CC BY-NC-SA 4.0 (non-commercial), as MASt3R's publishers state",
}

RENAMED = {
    "backbone.patch_embed.": "backbone.patch_embed.proj.",
    "backbone.intrinsics_embed.": "backbone.intrinsic_encoder.",
    "backbone.encoder.": "backbone.enc_blocks.",
    "backbone.encoder_norm.": "backbone.enc_norm.",
    "backbone.decoders.0.": "backbone.dec_blocks.",
    "backbone.decoders.1.": "backbone.dec_blocks2.",
    "backbone.decoder_norm.": "backbone.dec_norm.",
    ".norm_memory.": ".norm_y.",
    ".cross_attn.query.": ".cross_attn.projq.",
    "head.centres.0.": "downstream_head1.dpt.",
    "head.centres.1.": "downstream_head2.dpt.",
    "head.attributes.0.": "gaussian_param_head.dpt.",
    "head.attributes.1.": "gaussian_param_head2.dpt.",
    "dpt.trunk.reassemble.": "dpt.act_postprocess.",
    "dpt.conv.": "dpt.head.0.",
    "dpt.conv1.": "dpt.head.0.",
    "dpt.conv2.": "dpt.head.2.",
    "dpt.out.": "dpt.head.4.",
    "dpt.shortcut.": "dpt.input_merger.0.",
}
"""Parts of our names, in this order, and what they are in official ones."""
for _level in range(4):
    _fuse, _theirs = f"trunk.fuse.{_level}.", f"scratch.refinenet{_level + 1}."
    RENAMED |= {
        f"trunk.project.{_level}.": f"scratch.layer{_level + 1}_rn.",
        f"{_fuse}out.": f"{_theirs}out_conv.",
        f"{_fuse}skip.": f"{_theirs}resConfUnit1.",
        f"{_fuse}refine.": f"{_theirs}resConfUnit2.",
    }

_UNUSED = re.compile(
    r"backbone\.mask_token$|.*\.scratch\.refinenet4\.resConfUnit1\..+"
    r"|.*\.scratch\.layer_rn\.\d\.weight$"
)


def official_keys(ours: str, tensors: Mapping[str, Tensor]) -> tuple[str, ...]:
    """The keys in `tensors` that, joined along the first axis, are our parameter."""
    names = official_names(ours)
    return tuple(name if name in tensors else second_name(name) for name in names)


def official_names(ours: str) -> tuple[str, ...]:
    """Return the official keys which, joined along the first axis, are our parameter."""
    name = ours
    for part, theirs in RENAMED.items():
        name = name.replace(part, theirs)
    parts = ("projk", "projv") if ".key_value." in name else ("",)
    return tuple(name.replace("key_value", part) for part in parts)


def second_name(official: str) -> str:
    """Return the other name under which some official tensors are saved, or the same name."""
    match = re.fullmatch(r"(.+\.scratch)\.layer(\d)_rn\.weight", official)
    return f"{match[1]}.layer_rn.{int(match[2]) - 1}.weight" if match else official


def is_unused(official: str) -> bool:
    """Tell whether the official network saves the key but never reads it, or saves it twice."""
    return _UNUSED.match(official) is not None


def infer_parts(state: Mapping[str, Tensor], source: str) -> dict[str, PartChoice]:
    """Read the parts' sizes off the shapes of official tensors, except for attention heads.

    The parts are built empty: their weights come from the file.
    """
    try:
        backbone = PartChoice(name="asymmetric-vit", settings=_backbone(state) | EMPTY)
        head = PartChoice(name="dpt-gaussian", settings=_head(state) | EMPTY)
    except KeyError as error:
        raise InputError(
            f"{source}: key {error.args[0]!r} is missing, so the network's sizes cannot be read "
            "off it; expected a NoPoSplat or MASt3R checkpoint."
        ) from None
    return {"backbone": backbone, "head": head}


def _backbone(state: Mapping[str, Tensor]) -> dict:
    """Settings of the backbone."""
    width, _, patch = state["backbone.patch_embed.proj.weight"].shape[:3]
    return {
        "width": width,
        "depth": _count(state, r"backbone\.enc_blocks\.(\d+)\."),
        "decoder_width": len(state["backbone.decoder_embed.weight"]),
        "decoder_depth": _count(state, r"backbone\.dec_blocks\.(\d+)\."),
        "patch_size": patch,
    }


def _head(state: Mapping[str, Tensor]) -> dict:
    """Settings of the head."""
    dpt = "downstream_head1.dpt"
    settings = {
        "feature_width": len(state[f"{dpt}.scratch.refinenet1.out_conv.weight"]),
        "point_width": len(state[f"{dpt}.head.0.weight"]),
        "layer_widths": tuple(
            len(state[f"{dpt}.act_postprocess.{k}.0.weight"]) for k in range(4)
        ),
    }
    attributes = state.get("gaussian_param_head.dpt.head.4.weight")
    if attributes is not None:
        settings["harmonics_degree"] = round(((len(attributes) - 8) / 3) ** 0.5) - 1
    return settings


def _count(state: Mapping[str, Tensor], pattern: str) -> int:
    """One more than the highest block number."""
    numbers = [int(match[1]) for key in state if (match := re.match(pattern, key))]
    if not numbers:
        raise KeyError(pattern.replace("\\", "").replace("(d+)", "0"))
    return max(numbers) + 1


def read_torch_file(path: Path) -> Mapping[str, object]:
    """The dictionary of a `.ckpt` or `.pth`; tensors stay on disk until used, no code is run."""
    try:
        mapped = zipfile.is_zipfile(path)
        # MASt3R keeps its command line as an argparse.Namespace, which holds plain values only.
        with torch.serialization.safe_globals([argparse.Namespace]):
            content = torch.load(
                path, map_location="cpu", mmap=mapped, weights_only=True
            )
    except pickle.UnpicklingError as error:
        reason = str(error).split("\n")[0]
        raise InputError(
            f"{path}: refused, it holds more than tensors and plain values ({reason}); nothing "
            "in it was run. Ask its publisher for a safetensors file, or, where you trust all that "
            "it may run, make one of its state_dict yourself: safetensors.torch.save_file("
            "torch.load(FILE, weights_only=False)['state_dict'], NEW_FILE)."
        ) from None
    # a damaged file can make the reader raise almost anything
    except Exception as error:
        raise InputError(
            f"{path}: not a readable checkpoint ({' '.join(str(error).split())[:200]})."
        ) from None
    if not isinstance(content, Mapping):
        raise InputError(
            f"{path}: expected a checkpoint dictionary, found {type(content).__name__}."
        )
    return content


def layout_of(content: Mapping[str, object]) -> tuple[str, dict[str, Tensor]] | None:
    """("noposplat" or "mast3r", tensors by NoPoSplat's names without prefix); None for others."""
    named = {key: value for key, value in content.items() if isinstance(key, str)}
    tensors = {key: one for key, one in named.items() if isinstance(one, Tensor)}
    plain = {key.removeprefix(PREFIX): value for key, value in tensors.items()}
    if any(key.startswith("backbone.enc_blocks.") for key in plain):
        return "noposplat", plain
    if any(key.startswith("enc_blocks.") for key in tensors):
        return "mast3r", _from_mast3r(tensors)
    return None


def _from_mast3r(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """MASt3R's keys under NoPoSplat's names; confidence and local features are dropped."""
    result = {}
    for key, value in tensors.items():
        if "head_local_features" in key:
            continue
        if not key.startswith("downstream_head"):
            key = f"backbone.{key}"
        elif ".dpt.head.4." in key:
            value = value[:3]
        result[key] = value
    return result
