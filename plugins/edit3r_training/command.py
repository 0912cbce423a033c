"""`edit3r train CONFIG`: train from one configuration file; `--resume` continues where a run was
stopped.
"""

import argparse
from contextlib import nullcontext
from typing import TYPE_CHECKING

from edit3r.contract.command import Command
from edit3r.kit.command.flags import add_common, add_trust_flag

if TYPE_CHECKING:
    from edit3r.contract.settings import Settings


class TrainCommand(Command):
    """Train a reconstructor as one configuration file says."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        about = (
            "a YAML file, or the name of a shipped one such as training/edit3r-small"
        )
        parser.add_argument("config", help=about)
        earlier = parser.add_mutually_exclusive_group()
        about = "go on from the last checkpoint in the output folder"
        earlier.add_argument("--resume", action="store_true", help=about)
        about = "begin anew although the output folder holds another training"
        earlier.add_argument("--overwrite", action="store_true", help=about)
        about = "output folder, instead of the configuration's"
        parser.add_argument("--out", help=about)
        add_common(parser, "change a setting, e.g. trainer.steps=100")
        add_trust_flag(parser)

    def configuration(self) -> "type[Settings]":
        from edit3r_training.job import TrainingConfig

        return TrainingConfig

    def main(self, args: argparse.Namespace) -> int:
        from edit3r import default_registry
        from edit3r.contract.settings import merge
        from edit3r.kit import asking
        from edit3r.kit.command.results import alone_in, shown_stages
        from edit3r.kit.files.configs import parse_assignments, read_config
        from edit3r_training.job import prepare
        from edit3r_training.processes import is_first_process

        config = read_config(args.config, args.trust_config)
        values = merge(config, parse_assignments(args.set))
        if args.out:
            values = merge(values, {"out": args.out})
        first = is_first_process()  # of several that torchrun started, one talks
        with shown_stages(args.quiet or not first) as report, report.stage("train"):
            registry = default_registry(tuple(args.plugin))
            trainer, job = prepare(
                values, registry, resume=args.resume, overwrite=args.overwrite
            )
            with alone_in(job.out) if first else nullcontext():
                best = asking.train(trainer, job)
        if first:
            print(f"best checkpoint: {best}")
        return 0
