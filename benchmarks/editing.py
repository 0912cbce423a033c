"""What editors and methods that optimise do: looks, styles, things taken away, fits.

python benchmarks/editing.py looks|style|retouch|holes|fits --help
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import numpy as np
import torch
from edit3r_editors.retouch import behind, inpainted, smoothed
from harness import Row, run_benchmark
from likeness import disagreement

import edit3r
from edit3r.contract.errors import MatchingError
from edit3r.contract.interfaces import Geometry, SceneSample
from edit3r.contract.types import EditRequest, Gaussians, Views
from edit3r.kit.compute.lpips import lpips_distance
from edit3r.kit.compute.metrics import psnr
from edit3r.kit.geometry.cameras import project, unproject
from edit3r.kit.geometry.maps import dilate
from edit3r.kit.geometry.warping import shared_surface, warp
from edit3r.kit.photos.images import find_photos, packaged_pair, save_image
from edit3r.kit.reconstructing import WithMatcher

# ---- looks ----

WORST = ("night", "winter")


def measure(views: Views, edited: torch.Tensor, seconds: float) -> list[float]:
    change = float((edited - views.images).abs().mean())
    return [
        change,
        disagreement(views.images[0], edited[0]) or np.nan,
        seconds / views.count,
    ]


def scenes_of(pairs: list[str], size: int) -> list[Views]:
    """The packaged pair, and photos of folders."""
    scenes = [packaged_pair()[0]]
    for pair in pairs:
        folder, _, numbers = pair.rpartition(":")
        photos = find_photos([Path(folder)], 10_000)
        scenes.append([photos[int(number)] for number in numbers.split(",")])
    return [edit3r.load_views(scene, size=size) for scene in scenes]


def looks() -> None:
    """How alike do the editor's named looks change what two photos both show?

        python benchmarks/editing.py looks                          the packaged pair
        python benchmarks/editing.py looks FOLDER:FIRST,SECOND ...  and photos of folders

    A line a look, means over the pairs: how much the photos change (mean absolute difference, sRGB
    in [0, 1]), by how much the changes of the same spots differ between the two photos (the
    `disagreement` of likeness.py), the ratio, and processor seconds
    for one photo. `night to winter` stands for views that got different looks: what the measure
    says of edits that do not agree at all.
    """
    parser = argparse.ArgumentParser(
        description=looks.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("pairs", nargs="*", metavar="FOLDER:FIRST,SECOND")
    parser.add_argument("--size", type=int, default=448)
    options = parser.parse_args()
    scenes = scenes_of(options.pairs, options.size)
    from edit3r_editors.looks import LOOKS

    named = [look for look in LOOKS if not LOOKS[look].hides]
    editors = {look: edit3r.build("editor", "looks", look=look) for look in named}
    rows: dict[str, list[list[float]]] = {
        look: [] for look in [*named, " to ".join(WORST)]
    }
    for views in scenes:
        drawn = {}
        for look, editor in editors.items():
            start = time.process_time()
            drawn[look] = editor.edit(views, EditRequest("")).images
            rows[look].append(measure(views, drawn[look], time.process_time() - start))
        mixed = torch.cat((drawn[WORST[0]][:, :1], drawn[WORST[1]][:, 1:]), 1)
        rows[" to ".join(WORST)].append(measure(views, mixed, 0.0))
    print(
        "| look | change | disagreement | ratio | CPU s |\n| --- | --: | --: | --: | --: |"
    )
    for look, measured in rows.items():
        change, apart, seconds = np.nanmean(measured, 0)
        print(
            f"| {look} | {change:.3f} | {apart:.3f} | {apart / change:.2f} | {seconds:.2f} |"
        )


# ---- style ----


def style() -> None:
    """Do two photos agree in the style of a picture as they do in a named look?

        python benchmarks/editing.py style PICTURE ... --pairs FOLDER:FIRST,SECOND ...

    A line an edit, over the packaged pair and those of folders: LPIPS between the first edited
    photo and the second one laid on it where the geometry of the photos (matcher `classical`) says
    that both show one surface (as a share of that; 0: alike), and processor seconds for one photo.
    """
    parser = argparse.ArgumentParser(
        description=style.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("pictures", nargs="+", metavar="PICTURE")
    parser.add_argument("--pairs", nargs="*", default=[], metavar="FOLDER:FIRST,SECOND")
    parser.add_argument("--strokes", nargs="*", type=float, default=[0.0, 0.5, 1.0])
    parser.add_argument("--size", type=int, default=384)
    parser.add_argument("--out", type=Path, help="folder for the edited photos")
    options = parser.parse_args()
    editors = {
        "the photos": edit3r.build("editor", "none"),
        "looks: sketch": edit3r.build("editor", "looks", look="sketch"),
    }
    for picture in options.pictures:
        for strokes in options.strokes:
            settings = {"picture": picture, "strokes": strokes}
            name = f"{Path(picture).stem}, strokes {strokes:g}"
            editors[name] = edit3r.build("editor", "style", **settings)
    rows: dict[str, list[list[float]]] = {name: [] for name in editors}
    for number, views in enumerate(scenes_of(options.pairs, options.size)):
        geometry = edit3r.build("matcher", "classical").match(views)
        intrinsics = geometry.calibrated(views).intrinsics[0]
        places, same = shared_surface(geometry.depths[0], intrinsics, geometry.c2w[0])
        for name, editor in editors.items():
            start = time.process_time()
            first, second = editor.edit(views, EditRequest("")).images[0]
            seconds = (time.process_time() - start) / views.count
            laid = torch.where(same, warp(second, places), first)
            pair = (image.permute(1, 2, 0).numpy() for image in (first, laid))
            rows[name].append(
                [lpips_distance(*pair) / float(same.float().mean()), seconds]
            )
            if options.out:
                for view, image in enumerate((first, second)):
                    save_image(image, options.out / f"{number} {name} {view}.png")
    print("| edit | LPIPS of each pair | mean | CPU s |\n| --- | --- | --: | --: |")
    for name, measured in rows.items():
        apart, seconds = zip(*measured)
        each = " ".join(f"{value:.3f}" for value in apart)
        print(f"| {name} | {each} | {fmean(apart):.3f} | {fmean(seconds):.2f} |")


# ---- retouch ----

RING = 5  # width of the ring around a mask [pixels]


def psnr_there(image: torch.Tensor, truth: torch.Tensor, where: torch.Tensor) -> float:
    """Of the pixels in `where` [view height width]; images [view 3 height width]."""
    error = ((image - truth) ** 2).mean(1)[where].mean()
    return float(-10 * torch.log10(error.clamp(min=1e-10)))


def seen_behind(holes: torch.Tensor, depths: torch.Tensor, cameras) -> torch.Tensor:
    """Pixels of the holes [view height width] where another view's points fall that are no part of
    what is removed.
    """
    intrinsics, c2w, (height, width) = (
        cameras.intrinsics[0],
        cameras.c2w[0],
        holes.shape[-2:],
    )
    points, kept, seen = (
        unproject(depths, intrinsics, c2w),
        dilate(holes.float(), 2) == 0,
        torch.zeros_like(holes),
    )
    for view in range(len(holes)):
        others = [o for o in range(len(holes)) if o != view]
        lent = torch.cat([points[o][kept[o]] for o in others])
        places, z = project(lent, intrinsics[view], c2w[view])
        column, row = (places * torch.tensor([width, height])).floor().long().unbind(-1)
        inside = (
            (z > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        )
        seen[view][row[inside], column[inside]] = True
    return (dilate(seen.float(), 1) > 0) & holes


def rim_errors(
    editor, views: Views, changed: torch.Tensor, truth: torch.Tensor
) -> list[float]:
    """Mean absolute errors in the ring around masks that are 2 pixels too small.

    Of the photos, of `retouch` confined to these masks, and of `retouch` with the rims and shadows
    it asks for.
    """
    tight = (-dilate(-changed.float(), 2))[None]
    wide = editor.widened(tight[None], views.images)[0]
    ring = ((dilate(tight, RING) > 0) & (tight == 0))[0]
    results = [views.images]
    for masks in (tight, wide):
        edited = editor.edit(views, EditRequest("", 0, masks)).images
        results.append(torch.where(masks[:, :, None] > 0, edited, views.images))
    return [float((one[0] - truth).abs().mean(1)[ring].mean()) for one in results]


def retouch() -> None:
    """Is what `retouch` shows behind a removed object true? Generated scenes whose object can
    really be taken away.

        python benchmarks/editing.py retouch --scenes 24 --size 128

    Rims: mean absolute error in the ring of 5 pixels around masks that are 2 pixels too small.
    PSNR [dB] over the pixels of the holes, against the rendered truth: of a smooth filling of each
    photo alone, of `retouch`, and of `retouch` given the true depths; once where another photo sees
    behind the object (points of its true depths fall there), once over whole holes. Scenes whose
    photos cannot be matched are counted.
    """
    parser = argparse.ArgumentParser(
        description=retouch.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--scenes", type=int, default=24)
    parser.add_argument(
        "--size", type=int, default=128, help="side of the images [pixels]"
    )
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--seed", type=int, default=77)
    options = parser.parse_args()
    settings = {
        "image_size": options.size,
        "context": options.views,
        "edit": "remove",
        "seed": options.seed,
        "angles": [8, 25],
    }
    data = edit3r.build("dataset", "procedural", **settings)
    editor = edit3r.build("editor", "retouch")
    rows, rims = [], []
    lost = 0
    for index in range(options.scenes):
        sample = data[index]
        changed = (sample.context != sample.edited_context).any(1)
        holes = dilate(changed.float(), 1) > 0
        cameras = sample.context_cameras
        views = Views(
            sample.context[None],
            cameras.intrinsics,
            tuple(map(str, range(options.views))),
        )
        truth = Geometry(
            cameras.c2w, sample.context_depths[None], torch.ones_like(sample.context_depths)[None],
            torch.ones(1, options.views, dtype=torch.bool),
        )  # fmt: skip
        seen = seen_behind(holes, sample.context_depths, cameras)
        if int(seen.sum()) < 50:
            continue
        try:
            editor.matcher.match(views)
        except MatchingError:
            lost += 1
            continue
        retouched = editor.edit(views, EditRequest("", 0, holes[None].float())).images[
            0
        ]
        alone = torch.stack([smoothed(*one) for one in zip(views.images[0], holes)])
        best, carried, _ = behind(views, holes, truth, 0, 2)
        best = torch.stack([smoothed(*one) for one in zip(best, holes & ~carried)])
        rows.append([psnr_there(image, sample.edited_context, where)
                     for where in (seen, holes) for image in (alone, retouched, best)])  # fmt: skip
        rims.append(rim_errors(editor, views, changed, sample.edited_context))
        print(
            f"{sample.name:20} hole {float(holes.float().mean()):.3f} seen "
            f"{float(seen[holes].float().mean()):.2f}",
            *(f"{v:.1f}" for v in rows[-1]),
        )
    print(
        "error within {} pixels of masks that are 2 too small [1/255]: photo {:.1f}, "
        "retouch in the mask alone {:.1f}, with rim and shadow {:.1f}".format(
            RING, *(255 * np.nanmean(rims, 0))
        )
    )
    means, gains = np.mean(rows, 0), np.array(rows)[:, 1] - np.array(rows)[:, 0]
    told = [
        f"inpainting {a:.2f}, retouch {b:.2f}, with true depths {c:.2f} dB"
        for a, b, c in (means[:3], means[3:])
    ]
    print(f"{len(rows)} scenes, {lost} not matched; where another photo sees behind: {told[0]} "
          "(better in "
          f"{(gains > 0).sum()} scenes, median gain {np.median(gains):.2f}); whole holes: "
          f"{told[1]}")  # fmt: skip


def holes(
    photos: Path, *, seed: int = 0, count: int = 12, out: Path | None = None
) -> Iterator[Row]:
    """What is invented for ellipses that are cut out of photos, one of each set of a folder.

        python benchmarks/editing.py holes DATA [--seed 1]

    LPIPS to the photo, of the surroundings of each hole, at 448 pixels: of a smooth surface and of
    what the editor `retouch` shows; processor seconds of both. Another seed cuts other photos.
    """
    rng = np.random.default_rng(seed)
    kinds = (".jpg", ".jpeg", ".png")
    sets = [
        sorted(file for file in one.rglob("*") if file.suffix.lower() in kinds)
        for one in sorted(photos.iterdir())
    ]
    files = [one[len(one) // 2] for one in sets if one]
    rng.shuffle(files)
    for file in files[:count]:
        image = edit3r.load_views([file], size=448).images[0, 0]
        height, width = image.shape[1:]
        centre = rng.uniform(0.35, 0.75) * height, rng.uniform(0.25, 0.75) * width
        radii = rng.uniform(0.08, 0.16, 2) * (height, width)
        y, x = np.mgrid[:height, :width]
        ellipse = ((y - centre[0]) / radii[0]) ** 2 + ((x - centre[1]) / radii[1]) ** 2
        hole, place = torch.from_numpy(ellipse < 1), []
        for middle, radius in zip(centre, radii):
            reach = max(1.5 * radius, 32)
            place.append(slice(max(0, int(middle - reach)), int(middle + reach)))
        row, pictures = {"photo": f"{file.parent.name}/{file.name}"}, [image]
        for name, fill in (("smooth", smoothed), ("retouch", inpainted)):
            start = time.process_time()
            filled = fill(torch.where(hole, 0.0, image), hole)
            spent = time.process_time() - start
            near = [
                one[(slice(None), *place)].permute(1, 2, 0).numpy()
                for one in (filled, image)
            ]
            row |= {name: (lpips_distance(*near), ".3f"), f"{name}, s": (spent, ".2f")}
            pictures.append(filled)
        if out:
            save_image(torch.cat(pictures, 2), out / f"{file.parent.name}.png")
        yield row


# ---- fits ----

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


def fits() -> None:
    """What a fit of procedural scenes costs and gives: novel-view PSNR and CPU seconds against the
    number of steps.

        python benchmarks/editing.py fits --scenes 3 --views 2 --steps 100 300 1000
        python benchmarks/editing.py fits --methods --steps 300

    True poses, four novel views a scene, one thread (set OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1).
    CPU time of this process, so that other work on the machine changes little. The first line of a
    scene is the reconstruction that fits begin from.
    """
    parser = argparse.ArgumentParser(description=fits.__doc__.splitlines()[0])
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
    run_benchmark(looks, style, retouch, holes, fits)
