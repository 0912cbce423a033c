"""What a fit of procedural scenes costs and gives: novel-view PSNR and CPU seconds against the
number of steps.

    python benchmarks/refit_scenes.py --scenes 3 --views 2 --steps 100 300 1000
    python benchmarks/refit_scenes.py --methods --steps 300

True poses, four novel views a scene, one thread (set OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1). CPU
time of this process, so that other work on the machine changes little. The first line of a scene is
the reconstruction that fits begin from.
"""

import argparse
import time
from dataclasses import replace
from statistics import fmean

import torch

import edit3r
from edit3r.contract.interfaces import SceneSample
from edit3r.contract.types import EditRequest, Gaussians, Views
from edit3r.kit.compute.metrics import psnr
from edit3r.kit.reconstructing import WithMatcher

METHODS = ("refit", "instruct-nerf2nerf", "gaussctrl", "editsplat")
SCENE_SEED = 3  # of the data set; training and the benchmark use others


def sample_of(index: int, views: int, size: int) -> SceneSample:
    """One scene with `views` photos and four novel views."""
    return edit3r.build(
        "dataset",
        "procedural",
        image_size=size,
        context=views,
        targets=4,
        seed=SCENE_SEED,
    )[index]


def posed_views(sample: SceneSample) -> Views:
    """The photos with their true poses."""
    cameras = sample.context_cameras
    return Views(sample.context[None], cameras.intrinsics, c2w=cameras.c2w)


def novel_psnr(gaussians: Gaussians, sample: SceneSample, rasterizer) -> float:
    """Return the mean over the novel views [dB]."""
    with torch.no_grad():
        images = rasterizer.render(gaussians, sample.target_cameras).images[0]
    return fmean(
        psnr(image.numpy(), target.numpy())
        for image, target in zip(images, sample.target)
    )


def timed(call):
    """The result and the CPU seconds it took."""
    start = time.process_time()
    result = call()
    return result, time.process_time() - start


def measure_steps(args: argparse.Namespace) -> None:
    rasterizer = edit3r.build("rasterizer", "numba")
    print(
        f"{args.views} views of {args.size}x{args.size}; scene, steps, PSNR of novel views [dB], "
        "CPU [s], Gaussians"
    )
    for index in range(args.scenes):
        sample = sample_of(index, args.views, args.size)
        views = posed_views(sample)
        matcher = edit3r.build("matcher", "posed")
        first = WithMatcher(edit3r.build("reconstructor", "classical"), matcher)
        result, seconds = timed(lambda first=first, views=views: first(views))
        print(
            index,
            0,
            f"{novel_psnr(result.gaussians, sample, rasterizer):.2f} {seconds:.1f}",
            result.gaussians.count,
        )
        for steps in args.steps:
            method = WithMatcher(
                edit3r.build("reconstructor", "refit", steps=steps), matcher
            )
            result, seconds = timed(lambda method=method, views=views: method(views))
            decibels = novel_psnr(result.gaussians, sample, rasterizer)
            print(
                index,
                steps,
                f"{decibels:.2f} {seconds:.1f}",
                result.gaussians.count,
                flush=True,
            )


def measure_methods(args: argparse.Namespace) -> None:
    """Each method on one scene with the editor recolor, whose own time is next to nothing."""
    sample = sample_of(0, args.views, args.size)
    views, request = posed_views(sample), EditRequest("make it red")
    editor = edit3r.build("editor", "recolor")
    edited = editor.edit(views, request)
    wanted = editor.edit(
        Views(sample.target[None], sample.target_cameras.intrinsics), request
    )
    truth = replace(sample, target=wanted.images[0])
    rasterizer = edit3r.build("rasterizer", "numba")
    for name in METHODS:
        settings = {"steps": args.steps[0], "edit_steps": args.steps[0]}
        method = edit3r.build("reconstructor", name, {"editor": editor}, **settings)
        result, seconds = timed(lambda method=method: method(edited, views, request))
        print(
            name,
            f"{novel_psnr(result.gaussians, truth, rasterizer):.2f} dB {seconds:.1f} s",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=3)
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--steps", type=int, nargs="+", default=[100, 300, 1000])
    parser.add_argument(
        "--methods", action="store_true", help="one run of each method instead"
    )
    args = parser.parse_args()
    (measure_methods if args.methods else measure_steps)(args)


if __name__ == "__main__":
    main()
