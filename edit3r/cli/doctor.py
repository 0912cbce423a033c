"""`edit3r doctor`: is this installation sound? Versions, devices, plugins, every rasterizer, and a
tiny run.

Exits with 1 when something is wrong.
"""

import argparse
import importlib
import os
import platform
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import edit3r
from edit3r.contract.command import Command
from edit3r.contract.hookspecs import API_VERSION
from edit3r.plugins.check import check_offer
from edit3r.plugins.load import Offer
from edit3r.plugins.registry import (
    Registry,
    absent_device,
    default_registry,
    install_hint,
)
from edit3r.reporting import available_memory

if TYPE_CHECKING:
    from edit3r.pipeline.config import RunConfig
    from edit3r.reporting import Report

CORE_MODULES = {
    "torch": "torch",
    "numpy": "numpy",
    "scipy": "scipy",
    "kornia": "kornia",
    "cv2": "opencv-contrib-python-headless",
    "skimage": "scikit-image",
    "numba": "numba",
    "PIL": "pillow",
    "safetensors": "safetensors",
    "pydantic": "pydantic",
    "pluggy": "pluggy",
    "yaml": "pyyaml",
    "jaxtyping": "jaxtyping",
}
"""Importable name of each core dependency, and the package that brings it."""
JOB_SIZE = 96  # longer side of the tiny job's photos [pixels]
JOB_PROMPT = "make it blue"


class DoctorCommand(Command):
    """`edit3r doctor`."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "--device", metavar="D", help="torch device of the tiny job (default cpu)"
        )
        parser.add_argument(
            "--plugin",
            action="append",
            default=[],
            metavar="FILE",
            help="also load this local plugin",
        )

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.pipeline.config import make_run_config

        config = make_run_config(
            {"prompt": JOB_PROMPT, **({"device": args.device} if args.device else {})}
        )
        area, wrong = "", 0
        for finding in examine(default_registry(tuple(args.plugin)), config):
            if finding.area != area:
                area = finding.area
                print(f"{area}:")
            mark = {True: "ok   ", False: "WRONG", None: "note "}[finding.ok]
            print(f"  {mark} {finding.text}", flush=True)
            wrong += finding.ok is False
        print(f"\n{wrong} wrong." if wrong else "\nEverything is in order.")
        return 1 if wrong else 0


@dataclass(frozen=True)
class Finding:
    """One line of the report."""

    area: str  # "versions", "devices", "plugins", "rasterizers", "tiny job"
    text: str
    ok: bool | None = True  # None: worth knowing, nothing wrong


def examine(registry: Registry, config: "RunConfig") -> Iterator[Finding]:
    """All findings, as they are made; the tiny job runs the components that `config` names."""
    yield from versions()
    yield from devices()
    yield from plugins(registry)
    yield from rasterizers(registry)
    yield from tiny_job(registry, config)


def versions() -> Iterator[Finding]:
    """Python, edit3r, and every core dependency imported for real: a package may be there and
    broken.
    """
    python = f"Python {platform.python_version()} on {platform.system()} {platform.machine()}"
    yield Finding(
        "versions", f"edit3r {edit3r.__version__} (plugin API {API_VERSION}), {python}"
    )
    good = []
    for module, package in CORE_MODULES.items():
        try:
            importlib.import_module(module)
            good.append(f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            good.append(f"{package} (version unknown)")
        except Exception as error:
            cure = f"reinstall it: pip install {package}"
            yield Finding(
                "versions",
                f"{package} cannot be imported ({_in_words(error)}); {cure}",
                False,
            )
    yield Finding("versions", ", ".join(good))


def devices() -> Iterator[Finding]:
    """What torch can compute on."""
    import torch

    free = available_memory()
    memory = "" if free is None else f", {free / 2**30:.1f} GiB of memory free"
    yield Finding(
        "devices",
        f"cpu: {os.cpu_count()} cores, torch uses {torch.get_num_threads()} threads{memory}",
    )
    for index in range(torch.cuda.device_count()):
        free, total = (size / 2**30 for size in torch.cuda.mem_get_info(index))
        name = torch.cuda.get_device_name(index)
        yield Finding(
            "devices", f"cuda:{index}: {name}, {free:.1f} of {total:.1f} GiB free"
        )
    if torch.backends.mps.is_available():
        yield Finding("devices", "mps: Apple GPU")
    if torch.cuda.device_count() == 0 and not torch.backends.mps.is_available():
        yield Finding(
            "devices",
            "no GPU; everything that does not need one runs on the CPU",
            None,
        )


def plugins(registry: Registry) -> Iterator[Finding]:
    """Failed plugins and components that break their promise are wrong; a missing extra is worth
    knowing.
    """
    offers = registry.offers()
    for failure in registry.failures:
        yield Finding(
            "plugins", f"{failure.plugin} {failure.version}: {failure.reason}", False
        )
    for clash in registry.clashes():
        yield Finding("plugins", clash, False)
    problems = {offer: check_offer(registry, offer) for offer in offers}
    for offer, problem in problems.items():
        if problem:
            yield Finding("plugins", problem, False)
        elif registry.missing(offer):
            needs = f"{offer.kind} {offer.component.name} needs {', '.join(registry.missing(offer))}"
            yield Finding("plugins", f"{needs}; {install_hint(offer)}", None)
    usable = sum(
        1
        for offer, problem in problems.items()
        if not problem and not registry.missing(offer)
    )
    count = len({offer.plugin for offer in offers})
    yield Finding(
        "plugins",
        f"{usable} of {len(offers)} components from {count} plugins can be used here",
    )


def rasterizers(registry: Registry) -> Iterator[Finding]:
    """Every rasterizer draws one small scene."""
    for offer in registry.offers("rasterizer"):
        name = offer.component.name
        lacks = ", ".join(registry.missing(offer)) or absent_device(offer.component)
        if lacks:
            yield Finding("rasterizers", f"{name}: not here, needs {lacks}", None)
            continue
        started = time.perf_counter()
        try:
            finite = _draws(registry.build("rasterizer", offer.qualified_name), offer)
        except Exception as error:
            yield Finding("rasterizers", f"{name}: {_in_words(error)}", False)
            continue
        seconds = time.perf_counter() - started
        told = f"60 Gaussians in {seconds:.2f} s, compiling included"
        if not finite:
            told = "its image is not finite"
        yield Finding("rasterizers", f"{name}: {told}", finite)


def _draws(rasterizer: Any, offer: Offer) -> bool:
    """Whether the rasterizer makes a finite image of 60 Gaussians in front of one camera."""
    import torch

    from edit3r.contract.types import Cameras, Gaussians

    random = torch.Generator().manual_seed(0)
    means = torch.rand(1, 60, 3, generator=random) + torch.tensor([-0.5, -0.5, 2.0])
    gaussians = Gaussians(
        means=means,
        scales=torch.full((1, 60, 3), 0.05),
        quats=torch.tensor([1.0, 0, 0, 0]).repeat(1, 60, 1),
        opacities=torch.full((1, 60), 0.8),
        harmonics=torch.rand(1, 60, 1, 3, generator=random),
    )
    intrinsics = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]])[None, None]
    cameras = Cameras(torch.eye(4)[None, None], intrinsics, (48, 64))
    device = next(iter(offer.component.devices), "cpu")
    images = rasterizer.render(gaussians.to(device), cameras.to(device)).images
    return bool(torch.isfinite(images).all())


def tiny_job(registry: Registry, config: "RunConfig") -> Iterator[Finding]:
    """Photos, edit, reconstruction, rendering and a saved scene, at `JOB_SIZE` pixels."""
    started = time.perf_counter()
    try:
        report, count = _run_tiny(registry, config)
    except Exception as error:
        yield Finding("tiny job", _in_words(error), False)
        return
    for stage in report.stages:
        yield Finding("tiny job", f"{stage.name}: {stage.seconds:.2f} s")
    yield Finding(
        "tiny job",
        f"{count} Gaussians rendered and saved, {time.perf_counter() - started:.1f} s in all",
    )


def _run_tiny(registry: Registry, config: "RunConfig") -> tuple["Report", int]:
    """Run on the packaged photos as small as can be, render and save; the report, and how many
    Gaussians came.
    """
    from edit3r.io.images import load_views, packaged_pair
    from edit3r.io.ply import save_ply
    from edit3r.reporting import Report, collecting

    report = Report()
    with collecting(report), report.stage("read photos"):
        photos, cameras = packaged_pair()
        views = load_views(photos, cameras=cameras, size=JOB_SIZE)
    parts = {
        "editor": config.editor,
        "recon": config.reconstructor,
        "segmenter": config.segmenter,
    }
    result = edit3r.run(
        views,
        config.prompt,
        **parts,
        device=config.device,
        refine=4,
        registry=registry,
        report=report,
    )
    with (
        collecting(report),
        report.stage("render and save"),
        tempfile.TemporaryDirectory() as folder,
    ):
        rasterizer = registry.build(
            "rasterizer", config.rasterizer.name, **config.rasterizer.settings
        )
        rasterizer.render(result.gaussians, result.cameras)
        save_ply(Path(folder) / "scene.ply", result.gaussians)
    return report, result.gaussians.count


def _in_words(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
