"""`edit3r convert`: checkpoints of others to safetensors that name their parts."""

import argparse
import json
from collections.abc import Mapping
from pathlib import Path

from edit3r.contract.command import Command

DTYPES = ("float32", "bfloat16", "float16")


class ConvertCommand(Command):
    """Convert a NoPoSplat or MASt3R checkpoint to safetensors with a readable config beside it."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add = parser.add_argument
        about = ".ckpt, .pth, .safetensors, a folder, or a hub id"
        add("source", metavar="CHECKPOINT", help=about)
        about = "folder to write model.safetensors and config.json to"
        add("out", type=Path, metavar="FOLDER", help=about)
        about = "number format of the file (float32)"
        add("--dtype", choices=DTYPES, default="float32", help=about)
        about = "side the network was trained at (256)"
        add("--resolution", type=int, metavar="PIXELS", help=about)
        about = "attention heads, if not 64 channels each"
        add("--heads", type=int, help=f"encoder {about}")
        add("--decoder-heads", type=int, help=f"decoder {about}")
        about = "licence of the weights, where the file does not state it correctly"
        add("--licence", help=about)
        about = "of parts that a MASt3R file does not hold (0)"
        add("--seed", type=int, default=0, help=about)

    def main(self, args: argparse.Namespace) -> int:
        heads = {"heads": args.heads, "decoder_heads": args.decoder_heads}
        heads = {name: value for name, value in heads.items() if value}
        how = {name: getattr(args, name) for name in ("dtype", "resolution", "licence")}
        print(convert(args.source, args.out, heads=heads, seed=args.seed, **how))
        return 0


def convert(
    source: str,
    out: Path,
    dtype: str = "float32",
    resolution: int | None = None,
    heads: Mapping[str, int] | None = None,
    licence: str | None = None,
    seed: int = 0,
) -> str:
    """Read `source`, check every key, write it to folder `out`; return a sentence for the user.

    The other arguments are what a checkpoint does not say itself, `heads` the settings `heads` and
    `decoder_heads` of the backbone. Parts that the file lacks by design (MASt3R has no attribute
    head) are drawn from `seed`. Raises InputError for what does not fit.
    """
    # Imported here so that listing commands stays free of torch.
    import torch

    from edit3r.contract.errors import InputError
    from edit3r.contract.settings import PartChoice
    from edit3r.kit.files.atomic import sha256_of
    from edit3r.kit.weights.files import save_weights, whole_file
    from edit3r_model.checkpoints import (
        CONFIG,
        WEIGHTS,
        fill,
        load_weights,
        with_parts_of,
    )
    from edit3r_model.network import built

    loaded = load_weights(source)
    if loaded.path.resolve() == (out / WEIGHTS).resolve():
        raise InputError(
            f"{out}: source and target are the same; choose another folder."
        )
    if not loaded.parts:
        raise InputError(
            f"{source}: does not name the backbone and head it belongs to."
        )
    chosen = with_parts_of(loaded, {"backbone": heads or {}, "resolution": resolution})
    parts = {
        kind: PartChoice.model_validate(chosen[kind]) for kind in ("backbone", "head")
    }
    network = built(parts)
    for _, leaf in fill(network, loaded, seed):
        leaf.to(getattr(torch, dtype))
    state = network.state_dict()
    about = {
        **{kind: choice.model_dump() for kind, choice in parts.items()},
        "resolution": chosen.get("resolution", 256),
        "licence": licence or loaded.licence,
        "provenance": {
            "converted_from": Path(source).name,
            "sha256": sha256_of(loaded.path),
            "kind": loaded.kind,
            "drawn_at_random": loaded.drawn,
        },
    }
    metadata = {name: json.dumps(value) for name, value in about.items()}
    save_weights(out / WEIGHTS, state, metadata)
    with whole_file(out / CONFIG, "the description") as partial:
        partial.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    count = sum(value.numel() for value in state.values())
    drawn = f" {', '.join(loaded.drawn)} are random: train before use."
    return (
        f"{out}: {WEIGHTS} with {count:,} parameters in {dtype}, {CONFIG} beside it."
        f"{drawn if loaded.drawn else ''}"
    )
