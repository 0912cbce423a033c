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
from collections.abc import Iterator, Mapping
from pathlib import Path

import torch
from torch import Tensor

from edit3r.errors import InputError
from edit3r_model.full_network import NetworkConfig, PartConfig, empty_network

PREFIX = "encoder."
DRAWN_FROM_MAST3R = ("backbone.intrinsics_embed.", "head.attributes.")
"""What MASt3R does not have: as in the published recipe these parts start from random weights."""
LICENCES = {
    "noposplat": "not stated in the file; the published NoPoSplat weights start from MASt3R's, "
    "which are CC BY-NC-SA "
    "4.0 (non-commercial)",
    "mast3r": "CC BY-NC-SA 4.0 (non-commercial), as MASt3R's publishers state",
}

# (pattern of our name, official names to be joined, separated by spaces). `{role}` is the suffix of
# role 0 or 1, `{next}` the first number plus one.
_BACKBONE = (
    (r"patch_embed\.(.+)", "patch_embed.proj.{0}"),
    (r"intrinsics_embed\.(.+)", "intrinsic_encoder.{0}"),
    (r"encoder\.(.+)", "enc_blocks.{0}"),
    (r"encoder_norm\.(.+)", "enc_norm.{0}"),
    (r"decoder_norm\.(.+)", "dec_norm.{0}"),
    (r"decoder_embed\.(.+)", "decoder_embed.{0}"),
    (r"decoders\.(\d)\.(\d+)\.norm_memory\.(.+)", "dec_blocks{role}.{1}.norm_y.{2}"),
    (
        r"decoders\.(\d)\.(\d+)\.cross_attn\.query\.(.+)",
        "dec_blocks{role}.{1}.cross_attn.projq.{2}",
    ),
    (
        r"decoders\.(\d)\.(\d+)\.cross_attn\.key_value\.(.+)",
        "dec_blocks{role}.{1}.cross_attn.projk.{2} dec_blocks{role}.{1}.cross_attn.projv.{2}",
    ),
    (r"decoders\.(\d)\.(.+)", "dec_blocks{role}.{1}"),
)
_TRUNK = (
    (r"trunk\.reassemble\.(.+)", "act_postprocess.{0}"),
    (r"trunk\.project\.(\d)\.(.+)", "scratch.layer{next}_rn.{1}"),
    (r"trunk\.fuse\.(\d)\.out\.(.+)", "scratch.refinenet{next}.out_conv.{1}"),
    (r"trunk\.fuse\.(\d)\.skip\.(.+)", "scratch.refinenet{next}.resConfUnit1.{1}"),
    (r"trunk\.fuse\.(\d)\.refine\.(.+)", "scratch.refinenet{next}.resConfUnit2.{1}"),
)
_CENTRES = (
    *_TRUNK,
    (r"conv1\.(.+)", "head.0.{0}"),
    (r"conv2\.(.+)", "head.2.{0}"),
    (r"out\.(.+)", "head.4.{0}"),
)
_ATTRIBUTES = (
    *_TRUNK,
    (r"shortcut\.(.+)", "input_merger.0.{0}"),
    (r"conv\.(.+)", "head.0.{0}"),
    (r"out\.(.+)", "head.4.{0}"),
)
_UNUSED = re.compile(
    r"backbone\.mask_token$|.*\.scratch\.refinenet4\.resConfUnit1\..+|.*\.scratch\.layer_rn\.\d\.weight$"
)


class OfficialState(Mapping[str, Tensor]):
    """Official tensors under our names, joined on request; `drawn` are prefixes of what the file
    lacks by design.
    """

    def __init__(
        self, tensors: Mapping[str, Tensor], names: list[str], drawn: tuple[str, ...]
    ) -> None:
        self.tensors, self.drawn = tensors, drawn
        self.names = {ours: found for ours in names if (found := self._find(ours))}

    def _find(self, ours: str) -> tuple[str, ...]:
        keys = tuple(
            key if key in self.tensors else second_name(key)
            for key in official_names(ours)
        )
        return keys if all(key in self.tensors for key in keys) else ()

    def __getitem__(self, ours: str) -> Tensor:
        parts = [self.tensors[key] for key in self.names[ours]]
        return parts[0] if len(parts) == 1 else torch.cat(parts)

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)

    def unexpected(self) -> tuple[str, ...]:
        """Return the official keys that nothing of ours reads and that are not known to be
        unused.
        """
        read = {key for keys in self.names.values() for key in keys}
        read |= {second_name(key) for key in read}
        return tuple(
            key for key in self.tensors if key not in read and not is_unused(key)
        )


def read_official(
    content: Mapping[str, object], path: Path, source: str
) -> tuple[str, NetworkConfig, OfficialState]:
    """Return kind ("noposplat" or "mast3r"), sizes and tensors of a checkpoint dictionary;
    InputError for others.
    """
    kind, tensors = _normalise(content, path)
    config = infer_config(tensors, source)
    drawn = DRAWN_FROM_MAST3R if kind == "mast3r" else ()
    return kind, config, OfficialState(tensors, parameter_names(config), drawn)


def parameter_names(config: NetworkConfig) -> list[str]:
    """List all our parameter names of the published network with `config`'s sizes."""
    network = empty_network(
        config, heads=1, decoder_heads=1
    )  # any divisor: no shape depends on the heads
    return [name for name, _ in network.named_parameters()]


def official_names(ours: str) -> tuple[str, ...]:
    """Return the official keys which, joined along the first axis, are our parameter `backbone.*`
    or `head.*`.
    """
    part, _, rest = ours.partition(".")
    rules, prefix = _BACKBONE, "backbone."
    if part == "head":
        predictor, role, rest = rest.split(".", 2)
        if predictor == "centres":
            rules, prefix = _CENTRES, f"downstream_head{int(role) + 1}.dpt."
        else:
            rules, prefix = (
                _ATTRIBUTES,
                f"gaussian_param_head{'2' if role == '1' else ''}.dpt.",
            )
    for pattern, templates in rules:
        if found := re.fullmatch(pattern, rest):
            numbers = {
                "role": "2" if found[1] == "1" else "",
                "next": int(found[1]) + 1 if found[1].isdigit() else 0,
            }
            return tuple(
                prefix + template.format(*found.groups(), **numbers)
                for template in templates.split()
            )
    raise KeyError(ours)


def second_name(official: str) -> str:
    """Return the other name under which some official tensors are saved, or the same name."""
    found = re.fullmatch(r"(.+\.scratch)\.layer(\d)_rn\.weight", official)
    return f"{found[1]}.layer_rn.{int(found[2]) - 1}.weight" if found else official


def is_unused(official: str) -> bool:
    """Tell whether the official network saves the key but never reads it, or saves it twice."""
    return _UNUSED.match(official) is not None


def infer_config(state: Mapping[str, Tensor], source: str) -> NetworkConfig:
    """Read a network's sizes off the shapes of official tensors; attention heads are not among
    them.
    """
    try:
        return NetworkConfig(
            PartConfig("asymmetric-vit", _backbone(state)),
            PartConfig("dpt-gaussian", _head(state)),
        )
    except KeyError as error:
        raise InputError(
            f"{source}: key {error.args[0]!r} is missing, so the network's sizes cannot be read "
            "off it; expected a "
            f"NoPoSplat or MASt3R checkpoint."
        ) from None


def _backbone(state: Mapping[str, Tensor]) -> dict:
    """Settings of the backbone."""
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
    """Settings of the head."""
    dpt = "downstream_head1.dpt"
    settings = {
        "feature_width": state[f"{dpt}.scratch.refinenet1.out_conv.weight"].shape[0],
        "point_width": state[f"{dpt}.head.0.weight"].shape[0],
        "layer_widths": tuple(
            state[f"{dpt}.act_postprocess.{k}.0.weight"].shape[0] for k in range(4)
        ),
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


def read_torch_file(path: Path) -> Mapping[str, object]:
    """Read the dictionary in a `.ckpt` or `.pth`; tensors stay on disk until used, no code in the
    file is run.
    """
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
            "in it was run. Ask its "
            "publisher for a safetensors file, or, where you trust all that it may run, make "
            "one of its state_dict "
            "yourself: safetensors.torch.save_file(torch.load(FILE, "
            "weights_only=False)['state_dict'], NEW_FILE)."
        ) from None
    except (
        Exception
    ) as error:  # a damaged file can make the reader raise almost anything
        raise InputError(
            f"{path}: not a readable checkpoint ({' '.join(str(error).split())[:200]})."
        ) from None
    if not isinstance(content, Mapping):
        raise InputError(
            f"{path}: expected a checkpoint dictionary, found {type(content).__name__}."
        )
    return content


def _normalise(
    content: Mapping[str, object], path: Path
) -> tuple[str, dict[str, Tensor]]:
    """(kind, official tensors without prefix) of a checkpoint dictionary; kind is "noposplat" or
    "mast3r".
    """
    tensors = content.get("state_dict", content.get("model", content))
    if not isinstance(tensors, Mapping):
        raise InputError(
            f"{path}: its 'state_dict' or 'model' is a {type(tensors).__name__}, expected a "
            "mapping."
        )
    tensors = {
        key: value
        for key, value in tensors.items()
        if isinstance(key, str) and isinstance(value, Tensor)
    }
    if any(key.startswith(PREFIX + "backbone.") for key in tensors):
        return "noposplat", {
            key.removeprefix(PREFIX): value for key, value in tensors.items()
        }
    if any(key.startswith("backbone.") for key in tensors):
        return "noposplat", tensors
    if any(key.startswith("enc_blocks.") for key in tensors):
        return "mast3r", _from_mast3r(tensors)
    known = ", ".join(list(tensors)[:3]) or "none"
    raise InputError(
        f"{path}: neither a NoPoSplat checkpoint (keys 'encoder.backbone...') nor a MASt3R one "
        "(keys "
        f"'enc_blocks...'); its first keys: {known}."
    )


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
