"""`edit3r convert`: checkpoints of others to our format. `edit3r conflicts`: where a run's edits
contradict.
"""

import argparse
from pathlib import Path

from edit3r.contract.command import Command

DTYPES = ("float32", "bfloat16", "float16")


class ConvertCommand(Command):
    """Convert a NoPoSplat or MASt3R checkpoint to safetensors with a readable config beside it."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "source",
            metavar="CHECKPOINT",
            help=".ckpt, .pth, .safetensors, a folder, or a hub id",
        )
        parser.add_argument(
            "out",
            type=Path,
            metavar="FOLDER",
            help="folder to write model.safetensors and config.json to",
        )
        parser.add_argument(
            "--dtype",
            choices=DTYPES,
            default="float32",
            help="number format of the file (float32)",
        )
        parser.add_argument(
            "--resolution",
            type=int,
            metavar="PIXELS",
            help="side the network was trained at (256)",
        )
        parser.add_argument(
            "--heads", type=int, help="encoder attention heads, if not 64 channels each"
        )
        parser.add_argument(
            "--decoder-heads",
            type=int,
            help="decoder attention heads, if not 64 channels each",
        )
        parser.add_argument(
            "--licence",
            help="licence of the weights, where you know it better than the file says",
        )
        parser.add_argument(
            "--seed",
            type=int,
            default=0,
            help="of parts that a MASt3R file does not hold (0)",
        )

    def main(self, args: argparse.Namespace) -> int:
        # Imported here so that listing commands stays free of torch.
        from edit3r_model.checkpoints import convert

        heads = {"heads": args.heads, "decoder_heads": args.decoder_heads}
        print(
            convert(
                args.source,
                args.out,
                args.dtype,
                args.resolution,
                heads,
                args.licence,
                args.seed,
            )
        )
        return 0


class ConflictsCommand(Command):
    """Draw what each photo's Gaussians of a run show, how opaque they are, and where its edit
    contradicts photo 0's.
    """

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("run", metavar="RUN", help="folder that edit3r run wrote")
        parser.add_argument(
            "--rasterizer",
            default="auto",
            metavar="NAME",
            help="rasterizer (default auto)",
        )
        parser.add_argument(
            "--out",
            default="conflicts.png",
            metavar="FILE.png",
            help="figure (conflicts.png)",
        )
        parser.add_argument(
            "--overwrite", action="store_true", help="replace a file that is there"
        )

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.errors import InputError
        from edit3r.io.atomic import check_new_file
        from edit3r.pipeline.earlier import read_earlier_run
        from edit3r.plugins.registry import build
        from edit3r_model.conflict_figure import save_conflict_figure

        if Path(args.out).suffix != ".png":
            raise InputError(f"--out {args.out}: expected a file that ends in .png.")
        check_new_file(args.out, args.overwrite)
        run = read_earlier_run(args.run)
        figures = save_conflict_figure(
            args.out, run, build("rasterizer", args.rasterizer)
        )
        for name, (inside, outside) in zip(run.photos.names, figures):
            told = (
                "no conflict"
                if inside != inside
                else f"opacity {inside:.2f} inside conflicts"
            )
            print(f"{name}: {told}, {outside:.2f} elsewhere")
        return 0
