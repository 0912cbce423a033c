"""`edit3r evaluate`: a reconstructor on scenes whose truth is known: posed photos, data sets."""

import argparse
from pathlib import Path

from edit3r.contract.command import Command
from edit3r.contract.errors import SettingsError
from edit3r.contract.settings import make_settings, merge
from edit3r.kit.command.flags import add_common
from edit3r.kit.command.results import shown_stages, write_json, write_text
from edit3r.kit.files.atomic import check_new_file
from edit3r.kit.files.configs import parse_assignments
from edit3r.running import add_flags, given_flags
from edit3r_measure.evaluate_options import PARTS, EvaluateOptions, Evaluation


class EvaluateCommand(Command):
    """Measure a reconstructor on photos with known cameras or on generated scenes."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        places = "photos with a cameras.json or transforms.json, or a data set such as procedural"
        parser.add_argument("folders", nargs="+", metavar="FOLDER|NAME", help=places)
        add_flags(parser, EvaluateOptions)
        settings = "such as reconstructor.head.opacity=0.8 or dataset.seed=5"
        add_common(parser, settings, overwrite="replace a file that is there")

    def main(self, args: argparse.Namespace) -> int:
        # Heavy modules load now, so that the command line is parsed without them.
        from edit3r import default_registry
        from edit3r_measure.evaluate_scenes import as_markdown, as_records, measure

        given = merge(given_flags(args, Evaluation), parse_assignments(args.set))
        asked = make_settings(Evaluation, merge(PARTS, given), where="evaluate")
        if asked.out and Path(asked.out).suffix not in (".md", ".json"):
            raise SettingsError(
                f"--out {asked.out}: expected a file that ends in .md or .json."
            )
        if asked.out:
            check_new_file(asked.out, args.overwrite)
        registry = default_registry(tuple(args.plugin))
        with shown_stages(args.quiet) as report:
            scores = measure(asked, registry, report)
        text = as_markdown(scores)
        print(text, end="")
        if asked.out.endswith(".json"):
            write_json(asked.out, as_records(scores), indent=2)
        elif asked.out:
            write_text(asked.out, text)
        return 0
