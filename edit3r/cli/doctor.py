"""`edit3r doctor`: is everything in order? Exits with 1 when something is wrong."""

import argparse
import json

from edit3r.command import Command


class DoctorCommand(Command):
    """`edit3r doctor`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--editor", metavar="NAME", help="editor of the tiny job (default: that of edit3r run)")
        parser.add_argument(
            "--recon", metavar="NAME", help="reconstructor of the tiny job (default: that of edit3r run)"
        )
        parser.add_argument(
            "--rasterizer", metavar="NAME", help="rasterizer of the tiny job (default: that of edit3r run)"
        )
        parser.add_argument("--device", metavar="D", help="torch device of the tiny job (default cpu)")
        parser.add_argument("--json", action="store_true", help="machine-readable output")
        parser.add_argument("--plugin", action="append", default=[], metavar="FILE", help="also load this local plugin")

    def main(self, args: argparse.Namespace) -> int:
        from dataclasses import asdict

        from edit3r import doctor
        from edit3r.cli.run import DEFAULT_PROMPT
        from edit3r.registry import default_registry
        from edit3r.run_config import make_run_config

        named = {
            "editor": args.editor,
            "reconstructor": args.recon,
            "rasterizer": args.rasterizer,
            "device": args.device,
        }
        config = make_run_config({"prompt": DEFAULT_PROMPT, **{key: value for key, value in named.items() if value}})
        findings = []
        for finding in doctor.examine(default_registry(tuple(args.plugin)), config):
            if not args.json:
                _show(finding, new_area=not findings or findings[-1].area != finding.area)
            findings.append(finding)
        wrong = [finding for finding in findings if finding.ok is False]
        if args.json:
            print(json.dumps({"findings": [asdict(finding) for finding in findings], "wrong": len(wrong)}, indent=2))
        else:
            print(f"\n{len(wrong)} wrong." if wrong else "\nEverything is in order.")
        return 1 if wrong else 0


def _show(finding, new_area: bool) -> None:
    if new_area:
        print(f"{finding.area}:")
    mark = {True: "ok   ", False: "WRONG", None: "note "}[finding.ok]
    print(f"  {mark} {finding.text}", flush=True)
