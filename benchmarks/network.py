"""Time, memory and error of the NoPoSplat network in every precision; regenerates the table in the
docs.

    python benchmarks/network.py --size full --threads 1 --write docs/notes/network.md

Every mode runs in a fresh process, twice: alone, for its peak memory (loading included), and beside
`PlainNetwork`, turn by turn, for its time. Times are the processor's, not the
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

import torch
import torch.nn.functional as F
from torch import Tensor

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
    from edit3r.kit.geometry.cameras import intrinsics_from_fov

    height, width = SIZES[args.size][2]
    images = torch.rand(
        1, args.views, 3, height, width, generator=torch.Generator().manual_seed(0)
    )
    return images, intrinsics_from_fov(1.0, (height, width)).repeat(1, args.views, 1, 1)


def _table(rows: list[Row], args: argparse.Namespace) -> str:
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


class PlainNetwork:
    """The network of the benchmark's baseline: plain eager float32 layers in the published order,
    nothing done for speed.

    It reads the weights of the plugin's network under the plugin's names, so both compute the same
    thing; only the way differs: contiguous layouts, rotation in separate steps, keys and values of
    a concatenated memory, interpolation before the 1x1 convolution, whole maps at once. Attention
    is torch's fused kernel, as the published code allows.

    Tokens and raw maps of two or more views from a state dict with names `backbone.*` and `head.*`.
    """

    def __init__(
        self,
        state: dict[str, Tensor],
        depth: int,
        decoder_depth: int,
        head_width: int = 64,
    ) -> None:
        self.state, self.depth, self.decoder_depth, self.head_width = (
            state,
            depth,
            decoder_depth,
            head_width,
        )

    def __call__(self, images: Tensor, intrinsics: Tensor) -> tuple[Tensor, Tensor]:
        """(raw points [V,3,H,W], raw parameters [V,83,H,W]) of one scene, images [V,3,H,W] in [0,
        1].
        """
        levels = self.levels(images, intrinsics)
        grid = images.shape[-2] // 16, images.shape[-1] // 16
        maps = [
            x[:, :-1].transpose(1, 2).unflatten(-1, grid).contiguous() for x in levels
        ]
        pixels = images * 2 - 1
        parts = [
            self._heads(role, [m[own] for m in maps], pixels[own])
            for role, own in _ROLES
        ]
        return tuple(torch.cat(x) for x in zip(*parts))

    def levels(self, images: Tensor, intrinsics: Tensor) -> list[Tensor]:
        grid = images.shape[-2] // 16, images.shape[-1] // 16
        angles = self._angles(grid)
        tokens = (
            self._conv("backbone.patch_embed", images * 2 - 1, stride=16)
            .flatten(2)
            .transpose(1, 2)
        )
        x = torch.cat(
            (
                tokens,
                self._linear(
                    "backbone.intrinsics_embed", intrinsics.flatten(1)[:, None]
                ),
            ),
            1,
        )
        for i in range(self.depth):
            x = self._block(f"backbone.encoder.{i}", x, angles)
        x = self._norm("backbone.encoder_norm", x)
        kept, x = [x], self._linear("backbone.decoder_embed", x)
        wanted = (
            self.decoder_depth // 2,
            self.decoder_depth * 3 // 4,
            self.decoder_depth,
        )
        for i in range(self.decoder_depth):
            x = torch.cat([self._decode(i, x, view, angles) for view in range(len(x))])
            if i + 1 in wanted:
                kept.append(x)
        kept[-1] = self._norm("backbone.decoder_norm", x)
        return kept

    def _decode(self, level: int, tokens: Tensor, view: int, angles: Tensor) -> Tensor:
        name = f"backbone.decoders.{min(view, 1)}.{level}"
        others = [i for i in range(len(tokens)) if i != view]
        memory = self._norm(f"{name}.norm_memory", tokens[others].flatten(0, 1)[None])
        x = self._attend(name, tokens[view, None], angles)
        query = self._linear(f"{name}.cross_attn.query", self._norm(f"{name}.norm2", x))
        key, value = self._linear(f"{name}.cross_attn.key_value", memory).chunk(2, -1)
        mixed = self._mix(query, key, value, angles, angles.repeat(1, len(others), 1))
        x = x + self._linear(f"{name}.cross_attn.proj", mixed)
        return x + self._mlp(name, self._norm(f"{name}.norm3", x))

    def _block(self, name: str, x: Tensor, angles: Tensor) -> Tensor:
        x = self._attend(name, x, angles)
        return x + self._mlp(name, self._norm(f"{name}.norm2", x))

    def _attend(self, name: str, x: Tensor, angles: Tensor) -> Tensor:
        query, key, value = self._linear(
            f"{name}.attn.qkv", self._norm(f"{name}.norm1", x)
        ).chunk(3, -1)
        return x + self._linear(
            f"{name}.attn.proj", self._mix(query, key, value, angles, angles)
        )

    def _mix(
        self, query: Tensor, key: Tensor, value: Tensor, at: Tensor, memory_at: Tensor
    ) -> Tensor:
        query, key, value = (
            x.unflatten(-1, (-1, self.head_width)).transpose(1, 2)
            for x in (query, key, value)
        )
        mixed = F.scaled_dot_product_attention(
            _rotate(query, at), _rotate(key, memory_at), value
        )
        return mixed.transpose(1, 2).flatten(2)

    def _mlp(self, name: str, x: Tensor) -> Tensor:
        return self._linear(
            f"{name}.mlp.fc2", F.gelu(self._linear(f"{name}.mlp.fc1", x))
        )

    def _angles(self, grid: tuple[int, int]) -> Tensor:
        """[2, token, channels per axis]: what rows and columns turn by."""
        rows, columns = torch.meshgrid(*(torch.arange(n) for n in grid), indexing="ij")
        at = torch.stack(
            (
                torch.cat((rows.flatten(), torch.tensor([grid[0]]))),
                F.pad(columns.flatten(), (0, 1)),
            )
        )
        pairs = self.head_width // 4
        return (at[..., None] * 100.0 ** (-torch.arange(pairs) / pairs)).repeat(1, 1, 2)

    def _heads(
        self, role: int, maps: list[Tensor], pixels: Tensor
    ) -> tuple[Tensor, Tensor]:
        name = f"head.centres.{role}"
        half = self._conv(f"{name}.conv1", self._trunk(name, maps), padding=1)
        points = self._conv(
            f"{name}.out", F.relu(self._conv(f"{name}.conv2", _double(half), padding=1))
        )
        name = f"head.attributes.{role}"
        seen = F.relu(self._conv(f"{name}.shortcut", pixels, padding=3))
        fused = self._conv(
            f"{name}.conv", _double(self._trunk(name, maps)) + seen, padding=1
        )
        return points, self._conv(f"{name}.out", F.relu(fused))

    def _trunk(self, name: str, maps: list[Tensor]) -> Tensor:
        layers = []
        for k, x in enumerate(maps):
            x = self._conv(f"{name}.trunk.reassemble.{k}.0", x)
            if k < 2:
                weight, bias = self._weights(f"{name}.trunk.reassemble.{k}.1")
                x = F.conv_transpose2d(x, weight, bias, stride=weight.shape[-1])
            if k == 3:
                x = self._conv(f"{name}.trunk.reassemble.3.1", x, stride=2, padding=1)
            layers.append(self._conv(f"{name}.trunk.project.{k}", x, padding=1))
        path = self._fuse(f"{name}.trunk.fuse.3", layers[3])[
            ..., : maps[0].shape[-2], : maps[0].shape[-1]
        ]
        for k in (2, 1, 0):
            path = self._fuse(
                f"{name}.trunk.fuse.{k}",
                path + self._unit(f"{name}.trunk.fuse.{k}.skip", layers[k]),
            )
        return path

    def _fuse(self, name: str, x: Tensor) -> Tensor:
        return self._conv(f"{name}.out", _double(self._unit(f"{name}.refine", x)))

    def _unit(self, name: str, x: Tensor) -> Tensor:
        inner = self._conv(f"{name}.conv1", F.relu(x), padding=1)
        return x + self._conv(f"{name}.conv2", F.relu(inner), padding=1)

    def _weights(self, name: str) -> tuple[Tensor, Tensor | None]:
        return self.state[f"{name}.weight"], self.state.get(f"{name}.bias")

    def _linear(self, name: str, x: Tensor) -> Tensor:
        return F.linear(x, *self._weights(name))

    def _norm(self, name: str, x: Tensor) -> Tensor:
        weight, bias = self._weights(name)
        return F.layer_norm(x, weight.shape, weight, bias, 1e-6)

    def _conv(self, name: str, x: Tensor, stride: int = 1, padding: int = 0) -> Tensor:
        return F.conv2d(x, *self._weights(name), stride, padding)


_ROLES = ((0, slice(0, 1)), (1, slice(1, None)))


def _double(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=True)


def _rotate(x: Tensor, angles: Tensor) -> Tensor:
    """Rows turn the first half of the channels, columns the second; pairs are a quarter of the head
    apart.
    """
    turned = []
    for part, angle in zip(x.chunk(2, -1), angles):
        first, second = part.chunk(2, -1)
        turned.append(
            part * angle.cos() + torch.cat((-second, first), -1) * angle.sin()
        )
    return torch.cat(turned, -1)


if __name__ == "__main__":
    main()
