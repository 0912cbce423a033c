"""Where each of our parameters is found in an official state dict.

Official names are those of the published `re10k.ckpt` without its `encoder.` prefix. One of ours may be several of
theirs joined along the first axis, and one of theirs may go under two names.
"""

import re

# (pattern of ours, official templates to be joined). `{role}` picks the suffix of role 0 or 1.
_BACKBONE = (
    (r"patch_embed\.(.+)", ("patch_embed.proj.{0}",)),
    (r"intrinsics_embed\.(.+)", ("intrinsic_encoder.{0}",)),
    (r"encoder\.(.+)", ("enc_blocks.{0}",)),
    (r"encoder_norm\.(.+)", ("enc_norm.{0}",)),
    (r"decoder_norm\.(.+)", ("dec_norm.{0}",)),
    (r"decoder_embed\.(.+)", ("decoder_embed.{0}",)),
    (r"decoders\.(\d)\.(\d+)\.norm_memory\.(.+)", ("dec_blocks{role}.{1}.norm_y.{2}",)),
    (r"decoders\.(\d)\.(\d+)\.cross_attn\.query\.(.+)", ("dec_blocks{role}.{1}.cross_attn.projq.{2}",)),
    (
        r"decoders\.(\d)\.(\d+)\.cross_attn\.key_value\.(.+)",
        ("dec_blocks{role}.{1}.cross_attn.projk.{2}", "dec_blocks{role}.{1}.cross_attn.projv.{2}"),
    ),
    (r"decoders\.(\d)\.(.+)", ("dec_blocks{role}.{1}",)),
)
_TRUNK = (
    (r"trunk\.reassemble\.(.+)", "act_postprocess.{0}"),
    (r"trunk\.project\.(\d)\.(.+)", "scratch.layer{next}_rn.{1}"),
    (r"trunk\.fuse\.(\d)\.out\.(.+)", "scratch.refinenet{next}.out_conv.{1}"),
    (r"trunk\.fuse\.(\d)\.skip\.(.+)", "scratch.refinenet{next}.resConfUnit1.{1}"),
    (r"trunk\.fuse\.(\d)\.refine\.(.+)", "scratch.refinenet{next}.resConfUnit2.{1}"),
)
_CENTRES = (*_TRUNK, (r"conv1\.(.+)", "head.0.{0}"), (r"conv2\.(.+)", "head.2.{0}"), (r"out\.(.+)", "head.4.{0}"))
_ATTRIBUTES = (
    *_TRUNK,
    (r"shortcut\.(.+)", "input_merger.0.{0}"),
    (r"conv\.(.+)", "head.0.{0}"),
    (r"out\.(.+)", "head.4.{0}"),
)
_UNUSED = re.compile(
    r"backbone\.mask_token$|.*\.scratch\.refinenet4\.resConfUnit1\..+|.*\.scratch\.layer_rn\.\d\.weight$"
)


def official_names(ours: str) -> tuple[str, ...]:
    """Official keys which, joined along the first axis, are our parameter `ours` (`backbone.*` or `head.*`)."""
    part, _, rest = ours.partition(".")
    if part == "backbone":
        return tuple(f"backbone.{name}" for name in _backbone_names(rest))
    predictor, role, rest = rest.split(".", 2)
    if predictor == "centres":
        return (f"downstream_head{int(role) + 1}.dpt.{_head_name(_CENTRES, rest)}",)
    return (f"gaussian_param_head{'2' if role == '1' else ''}.dpt.{_head_name(_ATTRIBUTES, rest)}",)


def second_name(official: str) -> str:
    """The other name under which some official tensors are saved, or the same name."""
    found = re.fullmatch(r"(.+\.scratch)\.layer(\d)_rn\.weight", official)
    return f"{found[1]}.layer_rn.{int(found[2]) - 1}.weight" if found else official


def is_unused(official: str) -> bool:
    """True for keys that the official network saves but never reads, or saves twice."""
    return _UNUSED.match(official) is not None


def _backbone_names(rest: str) -> tuple[str, ...]:
    for pattern, templates in _BACKBONE:
        found = re.fullmatch(pattern, rest)
        if found:
            role = "2" if found[1] == "1" else ""
            return tuple(template.format(*found.groups(), role=role) for template in templates)
    raise KeyError(rest)


def _head_name(rules: tuple[tuple[str, str], ...], rest: str) -> str:
    for pattern, template in rules:
        found = re.fullmatch(pattern, rest)
        if found:
            following = int(found[1]) + 1 if found[1].isdigit() else 0
            return template.format(*found.groups(), next=following)
    raise KeyError(rest)
