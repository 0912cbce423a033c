"""`edit3r doctor`: is this installation sound?

Versions, devices, plugins, every rasterizer, and a tiny run. Exits with 1 when something is wrong.
"""

import argparse
import importlib
import os
import platform
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

import edit3r
from edit3r import Registry, __version__, default_registry
from edit3r.contract.command import Command
from edit3r.contract.component import Offer
from edit3r.contract.hookspecs import API_VERSION
from edit3r.contract.reporting import Report, available_memory
from edit3r.kit.command.flags import add_plugin_option
from edit3r.loading import absent_device, check_offer, install_hint

if TYPE_CHECKING:
    from edit3r.running import RunConfig

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
JOB_PROMPT = "make everything blue"
MARKS = {True: "ok   ", False: "WRONG", None: "note "}
GIB = 2**30


class DoctorCommand(Command):
    """Check versions, devices, memory, plugins and rasterizers, and run a tiny job."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "--device", metavar="D", help="torch device of the tiny job (default cpu)"
        )
        add_plugin_option(parser)

    def main(self, args: argparse.Namespace) -> int:
        from edit3r.running import make_run_config

        device = {"device": args.device} if args.device else {}
        config = make_run_config({"prompt": JOB_PROMPT}, device)
        wrong = 0
        for area, findings in examine(
            default_registry(tuple(args.plugin)), config
        ).items():
            print(f"{area}:")
            for finding in findings:
                print(f"  {MARKS[finding.ok]} {finding.text}", flush=True)
                wrong += finding.ok is False
        print(f"\n{wrong} wrong." if wrong else "\nEverything is in order.")
        return 1 if wrong else 0


@dataclass(frozen=True)
class Finding:
    """One line of the report."""

    text: str
    ok: bool | None = True  # None: worth knowing, nothing wrong


def examine(registry: Registry, config: "RunConfig") -> Mapping[str, Iterator[Finding]]:
    """All findings by area; the tiny job runs the components that `config` names."""
    return {
        "versions": versions(),
        "devices": devices(),
        "plugins": plugins(registry),
        "rasterizers": rasterizers(registry),
        "tiny job": tiny_job(registry, config),
    }


def versions() -> Iterator[Finding]:
    """Python, edit3r, and the core dependencies, imported for real: one may be there and broken."""
    system = f"{platform.system()} {platform.machine()}"
    yield Finding(
        f"edit3r {__version__} (plugin API {API_VERSION}), Python "
        f"{platform.python_version()} on {system}"
    )
    good = []
    for module, package in CORE_MODULES.items():
        try:
            importlib.import_module(module)
            good.append(f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            good.append(f"{package} (version unknown)")
        except Exception as error:
            yield Finding(
                f"{package} cannot be imported ({_in_words(error)}); reinstall it: pip install "
                f"{package}",
                False,
            )
    yield Finding(", ".join(good))


def devices() -> Iterator[Finding]:
    """What torch can compute on."""
    import torch

    memory = available_memory()
    told = "" if memory is None else f", {memory / GIB:.1f} GiB of memory free"
    threads = torch.get_num_threads()
    yield Finding(f"cpu: {os.cpu_count()} cores, torch uses {threads} threads{told}")
    gpus = torch.cuda.device_count()
    for index in range(gpus):
        free, total = torch.cuda.mem_get_info(index)
        name = torch.cuda.get_device_name(index)
        yield Finding(
            f"cuda:{index}: {name}, {free / GIB:.1f} of {total / GIB:.1f} GiB free"
        )
    if torch.backends.mps.is_available():
        yield Finding("mps: Apple GPU")
    elif gpus == 0 and torch.version.cuda:
        yield Finding(
            f"torch {torch.__version__} is built for CUDA, but this machine has no GPU: 3 GB for "
            "nothing; `uv pip install --torch-backend=auto torch` picks the right build",
            None,
        )
    elif gpus == 0:
        yield Finding("no GPU; what does not need one runs on the CPU", None)


def plugins(registry: Registry) -> Iterator[Finding]:
    """Failed plugins and components that break their promise are wrong, a missing extra is not."""
    for failure in registry.failures:
        yield Finding(f"{failure.plugin} {failure.version}: {failure.reason}", False)
    for clash in registry.clashes():
        yield Finding(clash, False)
    offers = registry.offers()
    usable = 0
    for offer in offers:
        problem = check_offer(registry, offer)
        missing = ", ".join(registry.missing(offer))
        if problem:
            yield Finding(problem, False)
        elif missing:
            needs = f"{offer.kind} {offer.component.name} needs {missing}"
            yield Finding(f"{needs}; {install_hint(offer)}", None)
        else:
            usable += 1
    count = len({offer.plugin for offer in offers})
    yield Finding(
        f"{usable} of {len(offers)} components from {count} plugins can be used here"
    )


def rasterizers(registry: Registry) -> Iterator[Finding]:
    """Every rasterizer draws a Gaussian."""
    for offer in registry.offers("rasterizer"):
        name = offer.component.name
        lacks = ", ".join(registry.missing(offer)) or absent_device(offer.component)
        if lacks:
            yield Finding(f"{name}: not available, needs {lacks}", None)
            continue
        started = time.perf_counter()
        try:
            finite = _draws(registry, offer)
        except Exception as error:
            yield Finding(f"{name}: {_in_words(error)}", False)
            continue
        seconds = time.perf_counter() - started
        text = f"draws in {seconds:.2f} s, compiling included"
        yield Finding(
            f"{name}: {text if finite else 'its image is not finite'}", finite
        )


def _draws(registry: Registry, offer: Offer) -> bool:
    """Whether a rasterizer makes a finite image of one Gaussian in front of one camera."""
    import torch

    from edit3r.contract.types import Cameras, Gaussians

    gaussians = Gaussians(
        means=torch.tensor([[[0.0, 0.0, 2.0]]]),
        scales=torch.full((1, 1, 3), 0.05),
        quats=torch.tensor([[[1.0, 0.0, 0.0, 0.0]]]),
        opacities=torch.full((1, 1), 0.8),
        harmonics=torch.zeros(1, 1, 1, 3),
    )
    intrinsics = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]])[None, None]
    cameras = Cameras(torch.eye(4)[None, None], intrinsics, (48, 64))
    device = next(iter(offer.component.devices), "cpu")
    rasterizer = registry.build("rasterizer", offer.qualified_name)
    images = rasterizer.render(gaussians.to(device), cameras.to(device)).images
    return bool(torch.isfinite(images).all())


def tiny_job(registry: Registry, config: "RunConfig") -> Iterator[Finding]:
    """The packaged photos, edited, reconstructed, rendered and saved at `JOB_SIZE` pixels."""
    from edit3r.kit.photos.images import packaged_pair
    from edit3r.kit.scenes.ply import save_ply

    report = Report()
    started = time.perf_counter()
    photos, cameras = packaged_pair()
    try:
        result = edit3r.run(
            photos,
            config.prompt,
            editor=config.editor,
            recon=config.reconstructor,
            rasterizer=config.rasterizer,
            segmenter=config.segmenter,
            cameras=cameras,
            size=JOB_SIZE,
            device=config.device,
            refine=4,
            registry=registry,
            report=report,
        )
        with report.stage("render and save"), tempfile.TemporaryDirectory() as folder:
            result.rasterizer.render(result.gaussians, result.cameras)
            save_ply(Path(folder, "scene.ply"), result.gaussians)
    except Exception as error:
        yield Finding(_in_words(error), False)
        return
    for stage in report.stages:
        yield Finding(f"{stage.name}: {stage.seconds:.2f} s")
    seconds = time.perf_counter() - started
    count = result.gaussians.count
    yield Finding(f"{count} Gaussians rendered and saved, {seconds:.1f} s in all")


def _in_words(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
