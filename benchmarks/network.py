"""Time, memory and error of the NoPoSplat network in every precision; regenerates the table in the
docs.

    python benchmarks/network.py --size full --threads 1 --write docs/notes/network.md

Every mode runs in a fresh process, twice: alone, for its peak memory (loading included), and beside
the plain eager float32 network, turn by turn, for its time. Times are the processor's, not the
wall's, the smallest of `--repeats`; the ratio to the plain network in the same process is what
survives a busy machine. Weights are random, so errors are those of arithmetic on an untrained
network: remeasure with trained weights before choosing a precision by them.
"""

import argparse
import json
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

MODES = {
    "float32": {"precision": "float32"},
    "auto": {"precision": "auto"},
    "bfloat16": {"precision": "bfloat16"},
    "bfloat16 backbone, float32 heads": {
        "precision": "bfloat16",
        "head_precision": "float32",
    },
    "int8 linears, float32 heads": {"precision": "int8", "head_precision": "float32"},
    "int8 linears, bfloat16 heads": {"precision": "int8", "head_precision": "bfloat16"},
    "int8 linears and convolutions": {"precision": "int8", "head_precision": "int8"},
}
SIZES = {
    "full": ({}, {}, (256, 256)),
    # full width: minutes, not an hour
    "shallow": (
        {"depth": 4, "decoder_depth": 4},
        {},
        (128, 128),
    ),
    "small": (
        {"width": 256, "depth": 6, "decoder_width": 192, "decoder_depth": 6},
        {"feature_width": 64, "point_width": 64, "layer_widths": (32, 64, 96, 192)},
        (128, 128),
    ),
}
START, END = (
    "<!-- network table: written by benchmarks/network.py -->",
    "<!-- end of network table -->",
)


@dataclass(frozen=True)
class Row:
    """One mode's figures."""

    mode: str
    seconds: float  # processor time of one run
    ratio: float  # plain network's time over this one's, same process
    plain_seconds: float
    peak_mb: float  # of a process that does nothing else
    errors: dict[str, float]  # relative L2 distance from the plain network's Gaussians


def main() -> None:
    args = _arguments()
    if args.measure:
        print(json.dumps(_measure(args)))
        return
    rows = [_row(mode, args) for mode in (args.modes or MODES)]
    table = _table(rows, args)
    print(table)
    if args.write:
        head, _, rest = args.write.read_text(encoding="utf-8").partition(START)
        tail = rest.partition(END)[2]
        args.write.write_text(f"{head}{START}\n{table}\n{END}{tail}", encoding="utf-8")
    if args.json:
        args.json.write_text(
            json.dumps([asdict(row) for row in rows], indent=1), encoding="utf-8"
        )


def _row(mode: str, args: argparse.Namespace) -> Row:
    memory, speed = (
        _in_fresh_process(mode, what, args) for what in ("memory", "speed")
    )
    row = Row(mode=mode, peak_mb=memory["peak_mb"], **speed)
    print(
        f"{mode}: {row.seconds:.2f} s, {row.ratio:.2f}x, {row.peak_mb:.0f} MB",
        file=sys.stderr,
        flush=True,
    )
    return row


def _in_fresh_process(mode: str, what: str, args: argparse.Namespace) -> dict:
    command = [
        sys.executable,
        __file__,
        "--measure",
        what,
        "--modes",
        mode,
        "--size",
        args.size,
    ]
    command += [
        "--threads",
        str(args.threads),
        "--repeats",
        str(args.repeats),
        "--views",
        str(args.views),
    ]
    threads = {
        "OMP_NUM_THREADS": str(args.threads),
        "MKL_NUM_THREADS": str(args.threads),
    }
    result = subprocess.run(
        command,
        env={**os.environ, **threads},
        capture_output=True,
        text=True,
        check=False,
    )
    if result.returncode:
        raise SystemExit(f"{mode}, {what}: {result.stderr[-2000:]}")
    return json.loads(result.stdout.splitlines()[-1])


def _measure(args: argparse.Namespace) -> dict:
    """Runs in the fresh process."""
    import torch

    from edit3r.contract.reporting import peak_memory_mb

    torch.set_num_threads(args.threads)
    mode = args.modes[0]
    images, intrinsics = _inputs(args)
    with torch.no_grad():
        network = _reconstructor(args.size, MODES[mode])
        if args.measure == "memory":
            network(images, intrinsics)
            return {"peak_mb": peak_memory_mb()}
        return _against_plain(network, images, intrinsics, args)


def _against_plain(
    network: Callable, images, intrinsics, args: argparse.Namespace
) -> dict:
    plain = _plain(args.size)
    fast, slow = float("inf"), float("inf")
    network(images, intrinsics)  # compilation, caches
    for _ in range(args.repeats):
        seconds, expected = _timed(lambda: plain(images, intrinsics))
        slow = min(slow, seconds)
        seconds, found = _timed(lambda: network(images, intrinsics))
        fast = min(fast, seconds)
    names = ("means", "opacities", "scales", "harmonics")
    errors = {n: _relative(getattr(found, n), getattr(expected, n)) for n in names}
    return {
        "seconds": fast,
        "plain_seconds": slow,
        "ratio": slow / fast,
        "errors": errors,
    }


def _timed(run: Callable) -> tuple[float, object]:
    started = time.process_time()
    result = run()
    return time.process_time() - started, result


def _relative(found, expected) -> float:
    return float((found.double() - expected.double()).norm() / expected.double().norm())


def _reconstructor(size: str, settings: dict):
    """The network of one mode, as the reconstructor runs it."""
    import edit3r

    backbone, head, _ = SIZES[size]
    built = edit3r.build(
        "reconstructor",
        "noposplat",
        weights="random",
        device="cpu",
        backbone=backbone,
        head=head,
        **settings,
    )
    return built.network


def _plain(size: str) -> Callable:
    """The baseline, as a function from pictures to Gaussians."""
    from edit3r_model.gaussian_adapter import adapt
    from plain_noposplat import PlainNetwork

    network = _reconstructor(size, {})
    depth, decoder_depth = (
        network.backbone.settings.depth,
        network.backbone.settings.decoder_depth,
    )
    plain = PlainNetwork(
        {k: v.detach() for k, v in network.named_parameters()}, depth, decoder_depth
    )

    def run(images, intrinsics):
        points, parameters = plain(images[0], intrinsics[0])
        return adapt(points[None], parameters[None], 0.001, 0.3, 4)

    return run


def _inputs(args: argparse.Namespace):
    import torch

    from edit3r.kit.geometry.cameras import intrinsics_from_fov

    height, width = SIZES[args.size][2]
    images = torch.rand(
        1, args.views, 3, height, width, generator=torch.Generator().manual_seed(0)
    )
    return images, intrinsics_from_fov(1.0, (height, width)).repeat(1, args.views, 1, 1)


def _table(rows: list[Row], args: argparse.Namespace) -> str:
    import torch

    size = "x".join(str(side) for side in SIZES[args.size][2])
    lines = [
        f"{args.size} size, {args.views} views of {size}, {args.threads} thread(s), random "
        "weights, torch "
        f"{torch.__version__}, {_processor()}; best of {args.repeats}.",
        "",
        f"<!-- figures: python benchmarks/network.py --size {args.size} "
        "--write docs/notes/network.md -->",
        "| mode | processor s | plain eager float32, same process, s | faster by | peak memory "
        "of the process | "
        "error of means / opacities / scales / harmonics |",
        "| --- | ---: | ---: | ---: | ---: | --- |",
    ]
    for row in rows:
        errors = " / ".join(f"{error:.1e}" for error in row.errors.values())
        lines.append(
            f"| {row.mode} | {row.seconds:.2f} | {row.plain_seconds:.2f} | {row.ratio:.2f}x | "
            f"{row.peak_mb:.0f} MB | "
            f"{errors} |"
        )
    return "\n".join(lines)


def _processor() -> str:
    table = Path("/proc/cpuinfo")
    found = (
        re.search(r"model name\s*: (.+)", table.read_text())
        if table.is_file()
        else None
    )
    return found[1] if found else platform.processor()


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", choices=SIZES, default="small")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument(
        "--modes",
        nargs="+",
        choices=MODES,
        metavar="MODE",
        help=f"of: {'; '.join(MODES)}",
    )
    parser.add_argument(
        "--write", type=Path, help="Markdown file whose table to replace"
    )
    parser.add_argument("--json", type=Path, help="also write the figures here")
    parser.add_argument(
        "--measure", choices=("memory", "speed"), help=argparse.SUPPRESS
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()
