"""Every door by which something from outside comes in: a whole thing to damage, the reader, and
what it may give back.

A door is a function of a random generator, an empty folder and the shared `Originals`. It puts one
damaged thing into the folder, reads it as the program does, and asserts that what was read is
sound. Whatever is refused must be refused with an `Edit3rError`; it names the file, the setting or
the thing in `names`.
"""

import asyncio
import base64
import dataclasses
import importlib.util
import io
import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import cv2
import numpy as np
import torch
from edit3r_training.checkpoint import TrainingState, copied_weights
from mangling import TEXTS, json_bytes, mangled_bytes, mangled_text, nasty
from PIL import Image

from edit3r.contract.interfaces import SceneToWrite
from edit3r.contract.types import Cameras, EditRequest, Gaussians, Views
from edit3r.kit.cache import Cache
from edit3r.kit.files.atomic import atomic_folder
from edit3r.kit.files.configs import parse_assignments, read_yaml
from edit3r.kit.files.names import unique_names
from edit3r.kit.photos.camera_files import (
    posed_cameras,
    read_cameras,
    read_scene_cameras,
    write_cameras,
)
from edit3r.kit.photos.coverage import take_frames
from edit3r.kit.photos.images import load_photos, save_image
from edit3r.kit.photos.masks import load_masks
from edit3r.kit.photos.temporary import temporary_photos
from edit3r.kit.provenance import recorded
from edit3r.kit.scenes.ply import load_ply, save_ply
from edit3r.kit.scenes.reading import load_scene
from edit3r.kit.weights.files import load_weights as load_trained
from edit3r.loading.registry import build, default_registry
from edit3r.running.config import make_run_config
from edit3r.running.run_folder import RunFolder
from edit3r_testing.scenes import gaussian_cloud

SIZE = (24, 32)


@dataclasses.dataclass(frozen=True)
class Originals:
    """Whole things, made once."""

    folder: Path
    files: dict[str, bytes]  # by name, what the doors damage
    trees: dict[str, object]  # by name, JSON data

    @property
    def photos(self) -> list[Path]:
        return [self.folder / "a.png", self.folder / "b.png"]


def make_originals(folder: Path) -> Originals:
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    pixels = np.stack((8 * x, 8 * y, x + y), -1).astype(np.uint8)
    files = {}
    for name, form in (
        ("a.png", "PNG"),
        ("b.png", "PNG"),
        ("c.jpg", "JPEG"),
        ("d.webp", "WEBP"),
        ("e.tif", "TIFF"),
    ):
        buffer = io.BytesIO()
        exif = Image.Exif()
        exif[0x0112], exif[0x9209] = 6, 1
        Image.fromarray(pixels[:, ::-1] if name == "b.png" else pixels).save(
            buffer, form, exif=exif.tobytes()
        )
        files[name] = buffer.getvalue()
    for name in ("a.png", "b.png"):
        Image.fromarray(pixels).save(folder / name)
    cameras, scene = _cameras(), _scene()
    save_ply(folder / "scene.ply", scene, comment_lines=["prompt: paint it red"])
    files["scene.ply"] = (folder / "scene.ply").read_bytes()
    for form in (
        ("spz", "sog", "splat", "compressed-ply")
        if importlib.util.find_spec("gaussforge")
        else ()
    ):
        writer = build("writer", form)
        writer.write(folder / "exported", SceneToWrite(scene))
        name = writer.offer.component.file_name("export")
        files[name] = (folder / "exported").read_bytes()
    files["clip.mp4"] = _video(folder / "clip.mp4")
    files["mask.png"] = _png((x > 10).astype(np.uint8) * 255)
    write_cameras(folder / "cameras.json", posed_cameras(cameras, ["a.png", "b.png"]))
    trees = {"cameras": json.loads((folder / "cameras.json").read_text())}
    trees["transforms"] = {
        **{
            "w": 32,
            "h": 24,
            "fl_x": 30.0,
            "fl_y": 30.0,
            "cx": 16.0,
            "cy": 12.0,
            "camera_model": "OPENCV",
            "k1": 0.01,
        },
        "frames": [
            {"file_path": f"{n}.png", "transform_matrix": np.eye(4).tolist()}
            for n in "ab"
        ],
    }
    trees["run"] = _earlier_run(
        folder / "run",
        cameras,
        scene,
        load_photos([folder / "a.png", folder / "b.png"]),
    )
    files["cache"] = _cache_entry(folder / "cache")
    network, optimizer = _network()
    TrainingState(network, optimizer, copied_weights(network), step=3).save(
        folder / "last.pt"
    )
    files["last.pt"] = (folder / "last.pt").read_bytes()
    shutil.rmtree(folder / "cache")
    return Originals(folder, files, trees)


# ---- the doors ----


def pictures(rng, folder, given):
    name = rng.choice(("a.png", "c.jpg", "d.webp", "e.tif"))
    file = folder / rng.choice((name, "photo.jpg", "photo.png"))
    file.write_bytes(mangled_bytes(rng, given.files[name]))
    loaded = load_photos([given.photos[1], file], size=32)
    images = loaded.views.images
    assert (
        images.shape[1] == 2
        and torch.isfinite(images).all()
        and images.min() >= 0
        and images.max() <= 1
    )
    assert torch.isfinite(loaded.views.intrinsics).all()


def masks(rng, folder, given):
    (folder / "mask.png").write_bytes(mangled_bytes(rng, given.files["mask.png"]))
    read = load_masks([folder / "mask.png"] * 2, load_photos(given.photos, size=32))
    assert read.shape == (1, 2, *SIZE) and read.min() >= 0 and read.max() <= 1


def cameras(rng, folder, given):
    name = rng.choice(("cameras", "transforms"))
    file = folder / f"{name}.json"
    file.write_bytes(json_bytes(rng, given.trees[name]))
    for camera in read_cameras(file):
        assert camera.width >= 1 and camera.height >= 1 and Path(camera.file).name
        if camera.c2w is not None:
            assert np.allclose(
                camera.c2w[:3, :3] @ camera.c2w[:3, :3].T, np.eye(3), atol=0.05
            )
            assert (
                np.linalg.det(camera.c2w[:3, :3]) > 0.5
                and np.abs(camera.c2w).max() < 1e9
            )
        if camera.K is not None:
            assert np.isfinite(camera.K).all() and np.linalg.det(camera.K) > 0
    for photo in given.photos:
        shutil.copy(photo, folder)
    views = load_photos(
        [folder / "a.png", folder / "b.png"], size=32, cameras=file
    ).views
    assert torch.isfinite(views.intrinsics).all() and (
        views.c2w is None or torch.isfinite(views.c2w).all()
    )
    scene, _ = read_scene_cameras(file)
    page = SceneToWrite(_scene(), scene)
    build("writer", "viewer").write(folder / "viewer.html", page)


def yaml_files(rng, folder, given):
    text = "prompt: paint it red\nseed: 3\neditor: {name: recolor, strength: 0.5}\nframes: 8\n"
    (folder / "c.yaml").write_bytes(
        mangled_text(rng, text).encode(errors="surrogatepass")
    )
    content = read_yaml(folder / "c.yaml")
    assert all(isinstance(key, str) for key in content)
    _built(make_run_config(content))


def assignments(rng, folder, given):
    key = rng.choice(
        (
            "seed",
            "frames",
            "prompt",
            "editor",
            "editor.strength",
            "size",
            "fov",
            "refiners",
            "gaussians",
        )
    )
    key = rng.choice(
        (
            key,
            key,
            f"{key}.{rng.choice(TEXTS)}",
            rng.choice(TEXTS),
            "matcher.kind",
        )
    )
    value = rng.choice(
        (
            json.dumps(nasty(rng)),
            rng.choice(TEXTS),
            mangled_text(rng, "{name: recolor, strength: 1}"),
        )
    )
    _built(
        make_run_config(
            parse_assignments(
                [f"{key}={value}", rng.choice(("seed=3", "editor=recolor"))]
            )
        )
    )


def checkpoints(rng, folder, given):
    network, optimizer = _network()
    state = TrainingState(network, optimizer, copied_weights(network))
    (folder / "last.pt").write_bytes(mangled_bytes(rng, given.files["last.pt"]))
    state.load(folder / "last.pt")
    assert state.step >= 0


def resume_states(rng, folder, given):
    whole = given.files["cache"]
    entry = rng.choice((whole, mangled_bytes(rng, whole), mangled_bytes(rng, whole)))
    (folder / "match-0.safetensors").write_bytes(entry)
    answer = Cache(folder).recall("match", "0", lambda: None)
    assert answer is None or isinstance(answer, Views)


def weights(rng, folder, given):
    from edit3r_model.checkpoints import load_weights
    from safetensors.torch import save

    content = save({"a.weight": torch.zeros(3, 3), "b": torch.ones(2)})
    file = folder / rng.choice(("w.safetensors", "w.ckpt", "w.pth"))
    content = rng.choice((content, given.files["last.pt"]))
    file.write_bytes(mangled_bytes(rng, content) if rng.random() < 0.6 else content)
    if rng.random() < 0.5:
        (folder / "config.json").write_bytes(
            json_bytes(rng, {"format": 1, "width": 8, "licence": "x"})
        )
    if rng.random() < 0.3:
        content = save(torch.nn.Linear(3, 3).state_dict())
        file.write_bytes(mangled_bytes(rng, content) if rng.random() < 0.7 else content)
    if rng.random() < 0.5:
        load_weights(file)
    else:
        network = torch.nn.Linear(3, 3)
        load_trained(network, file)
        assert all(value.isfinite().all() for value in network.state_dict().values())


def plies(rng, folder, given):
    head, end, rows = given.files["scene.ply"].partition(b"end_header\n")
    if rng.random() < 0.5:
        head = mangled_text(rng, head.decode()).encode(errors="replace")
    else:
        rows = mangled_bytes(rng, rows)
    (folder / "scene.ply").write_bytes(head + end + rows)
    _sound(load_ply(folder / "scene.ply"))


def videos(rng, folder, given):
    (folder / "clip.mp4").write_bytes(mangled_bytes(rng, given.files["clip.mp4"]))
    with temporary_photos():
        for file in take_frames(folder / "clip.mp4", 3):
            assert load_photos([given.photos[0], file], size=32).views.count == 2


def exports(rng, folder, given):
    """Files of other programs; those of PLY have a door of their own."""
    name = rng.choice([name for name in given.files if name.startswith("export")])
    (folder / name).write_bytes(mangled_bytes(rng, given.files[name]))
    _sound(load_scene(folder / name))


def run_folders(rng, folder, given):
    run = folder / "run"
    shutil.copytree(given.folder / "run", run)
    damaged = rng.choice(
        (
            "run.json",
            "run.json",
            "run.json",
            "cameras.json",
            "scene.ply",
            "inputs/a.png",
        )
    )
    content = (run / damaged).read_bytes()
    tree = json.loads(content) if damaged.endswith(".json") else None
    (run / damaged).write_bytes(
        mangled_bytes(rng, content) if tree is None else json_bytes(rng, tree)
    )
    read = RunFolder(run).read()
    earlier = read.inputs
    _sound(earlier.before.gaussians)
    for views in (earlier.photos, earlier.start):
        assert (
            torch.isfinite(views.images).all()
            and torch.isfinite(views.intrinsics).all()
        )
        for name in views.names:
            assert (folder / "out" / f"{name}.png").resolve().parent == folder / "out"
    assert len(set(earlier.photos.names)) == len(earlier.files) == earlier.photos.count
    mask = folder / "mask.png"
    Image.new("L", (32, 24), 255).save(mask)
    load_masks(
        [mask] * earlier.photos.count,
        SimpleNamespace(photos=earlier.files),
    )
    make_run_config(read.settings)


def manifests(rng, folder, given):
    from edit3r_bench.manifest import load_item, read_bench_manifest

    hashes = {photo.name: edit3r_hash(photo) for photo in given.photos}
    frames = [{"file": name, "sha256": digest} for name, digest in hashes.items()]
    item = {
        "id": "s-1",
        "scene": "s",
        "type": "Modify",
        "prompt": "paint it",
        "inputs": [0, 1],
        "masks": [],
        "seed": 3,
    }
    tree = {
        **{
            "format": "edit3r-bench",
            "version": 1,
            "name": "x",
            "image_size": 64,
            "items": [item],
        },
        "scenes": [
            {
                "id": "s",
                "folder": str(given.folder),
                "cameras": "cameras.json",
                "frames": frames,
            }
        ],
    }
    (folder / "m.json").write_bytes(json_bytes(rng, tree))
    manifest = read_bench_manifest(folder / "m.json")
    for item in manifest.items:
        assert (folder / item.id).resolve().parent == folder
        loaded = load_item(manifest, item, folder, default_registry())
        assert torch.isfinite(loaded.photos.images).all() and loaded.inputs == len(
            item.inputs
        )


def jobs_files(rng, folder, given):
    from edit3r_batch.jobs import read_jobs

    photos = [str(photo) for photo in given.photos]
    job = {
        "id": "bike",
        "photos": photos,
        "prompt": "paint it",
        "seed": 3,
        "point": ["1:3,4"],
        "editor": {"name": "none"},
    }
    second = (
        json_bytes(rng, job)
        if rng.random() < 0.8
        else mangled_bytes(rng, json.dumps(job).encode())
    )
    (folder / "jobs.jsonl").write_bytes(
        json.dumps({**job, "id": "first"}).encode() + b"\n" + second
    )
    jobs = read_jobs(
        folder / "jobs.jsonl", {"size": 32}, default_registry(), trusted=True
    )
    for name, job in jobs.items():
        assert (folder / name).resolve().parent == folder and not (
            folder / name
        ).exists()
        assert json.loads(json.dumps(job.record)) == job.record
        make_run_config(job.settings)
    assert len({name.casefold() for name in jobs}) == len(jobs)


def recipes(rng, folder, given):
    from edit3r_recolor.scene import FORMAT, SceneRecipe

    tree = {"format": FORMAT, "seed": 0, "masks": "x", "regions": [], "views": []}
    tree["views"] = [{"name": "a", "objects": [1], "overlap": 0.5, "processed": True}]
    (folder / "recolor.json").write_bytes(json_bytes(rng, tree))
    SceneRecipe.load(folder / "recolor.json")


def prompts(rng, folder, given):
    from edit3r.contract.instructions import Instruction
    from edit3r.running import usual_reader

    text = mangled_text(
        rng,
        "paint the bike light blue, make it much darker; all but the wall from grey to red",
    )
    text *= rng.choice((1, 1, 1, 40, 20_000))
    prompt = make_run_config({"prompt": text}).prompt
    save_ply(folder / "scene.ply", _scene(), comment_lines=[f"prompt: {prompt}"])
    _sound(load_ply(folder / "scene.ply"))
    scene = SceneToWrite(_scene(), _cameras(), title=prompt, names=(prompt, "b"))
    build("writer", "viewer").write(folder / "viewer.html", scene)
    page = (folder / "viewer.html").read_text(encoding="utf-8")
    meta = page.partition('<script id="meta" type="application/json">')[2].partition(
        "</script>"
    )[0]
    assert json.loads(meta)["title"] == prompt and page.count("<script") == 3
    assert all(
        isinstance(instruction, Instruction)
        for instruction in usual_reader().read(prompt)
    )


def names(rng, folder, given):
    asked = [
        rng.choice((rng.choice(TEXTS), mangled_text(rng, "IMG_0001")))
        for _ in range(rng.choice((1, 3, 8)))
    ]
    found = unique_names(asked)
    assert (
        len({name.casefold() for name in found}) == len(asked)
        and unique_names(found) == found
    )
    for name in found:
        save_image(torch.rand(3, 2, 2), folder / f"{name}.png")
    assert len([path for path in folder.iterdir() if path.is_file()]) == len(asked)
    json.dumps(recorded(asked), ensure_ascii=False).encode()


def output_paths(rng, folder, given):
    (folder / "file").write_text("mine")
    (folder / "mine").mkdir()
    (folder / "mine" / "thesis.tex").write_text("mine")
    place = rng.choice(
        (
            "new",
            "file",
            "mine",
            "file/x",
            "mine/new",
            rng.choice(TEXTS).lstrip("/~").replace("..", ""),
        )
    )
    out = Path(f"{folder}/{place}")
    with atomic_folder(out, overwrite=rng.random() < 0.5) as partial:
        (partial / "scene.ply").write_text("new")
    assert (out / "scene.ply").read_text() == "new"
    assert (
        (folder / "file").read_text()
        == "mine"
        == (folder / "mine" / "thesis.tex").read_text()
    )
    assert not list(folder.rglob(".*.partial-*"))


def service_answers(rng, folder, given):
    from edit3r_remote.dispatch import Dispatcher
    from edit3r_remote.gpt_image import OpenAiImages
    from edit3r_remote.service import ImageService, RemoteSettings

    class Service(OpenAiImages):
        label = "fake"
        variables = ("EDIT3R_FUZZ_KEY",)

        def __init__(self, settings):
            ImageService.__init__(self, settings)
            self.chosen = {}
            self.client = SimpleNamespace(images=SimpleNamespace(edit=self.respond))

        def respond(self, **asked):
            whole = _png(np.zeros((24, 32, 3), np.uint8))
            image = rng.choice(
                (b"x " + self.key.encode(), mangled_bytes(rng, whole), whole, whole)
            )
            usage = SimpleNamespace(input_tokens=nasty(rng), output_tokens=nasty(rng))
            data = [SimpleNamespace(b64_json=base64.b64encode(image).decode())]
            if rng.random() < 0.1:
                raise rng.choice((OSError, ValueError, RuntimeError))(f"key {self.key}")
            return SimpleNamespace(
                data=rng.choice((data, data, data, nasty(rng))),
                usage=rng.choice((usage, nasty(rng))),
            )

    settings = RemoteSettings(
        model="x",
        input_price=1,
        output_price=1,
        cache=str(folder / "cache"),
        concurrent=1,
    )
    views = load_photos(given.photos[:1], size=32).views
    with mock.patch.dict(os.environ, EDIT3R_FUZZ_KEY="sk-secret-0123456789"):
        service = Service(settings)
    edited = Dispatcher(service, {}).edit(
        views, EditRequest("paint"), (SIZE,), send_masks=False
    )
    assert (
        edited.images.shape == views.images.shape
        and torch.isfinite(edited.images).all()
    )
    assert not any(
        b"sk-secret" in path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    )


def uploads(rng, folder, given):
    """What a browser sends to `edit3r app`."""
    from edit3r_app.jobs import JobsFolder
    from edit3r_app.uploads import receive

    async def chunks():
        yield mangled_bytes(
            rng, given.files[rng.choice(("a.png", "c.jpg", "d.webp", "e.tif"))]
        )

    jobs = JobsFolder(folder / "jobs")
    scene = jobs.new_scene(rng.choice(TEXTS))
    name = mangled_text(
        rng, rng.choice(("a.png", "photo.JPG", "../x.webp", "C:\\y.tif"))
    )
    try:
        kept = asyncio.run(
            receive(jobs, scene, name, rng.choice((None, 0, 10**4, 10**12)), chunks())
        )
    finally:
        assert jobs.path(scene).parent == jobs.root and not list(jobs.private.iterdir())
    assert kept.parent == jobs.path(scene) / "images"
    assert list(jobs.photos(scene).values()) == [kept]


def app_records(rng, folder, given):
    """The files that `edit3r app` keeps beside photos and runs."""
    from edit3r_app.draft import read_draft
    from edit3r_app.jobs import AppJob, JobsFolder, tree

    jobs = JobsFolder(folder / "jobs")
    name = jobs.new_job(
        AppJob("", jobs.new_scene("bear"), settings={"prompt": "gold"})
    ).name
    record = jobs.private / f"{name}.json"
    record.write_bytes(json_bytes(rng, json.loads(record.read_text())))
    (jobs.root / name).mkdir()
    (jobs.root / name / "run.json").write_bytes(json_bytes(rng, given.trees["run"]))
    (jobs.beside("bear") / "draft.json").write_bytes(
        json_bytes(rng, {"positive": [[0, 0.5, 0.5]], "form": {}})
    )
    history = [job for job in jobs.jobs() if job.name == name]
    assert len(history) == 1 and history[0].state == "done" and len(tree(history)) <= 1
    jobs.scenes()
    read_draft(jobs, "bear")


DOORS: dict[str, Callable] = {
    door.__name__: door
    for door in (
        *(
            pictures,
            masks,
            cameras,
            yaml_files,
            assignments,
            checkpoints,
            resume_states,
            weights,
            plies,
            run_folders,
        ),
        *(
            manifests,
            recipes,
            prompts,
            names,
            output_paths,
            service_answers,
            videos,
            uploads,
            app_records,
        ),
        jobs_files,
        *((exports,) if importlib.util.find_spec("gaussforge") else ()),
    )
}


# ---- what they are made of ----


def edit3r_hash(file: Path) -> str:
    from edit3r_bench.manifest import hash_of_file

    return hash_of_file(file)


def _built(config) -> None:
    """Build what a configuration names, as a run does first."""
    assert config.prompt.encode() is not None
    for kind in ("editor", "rasterizer"):
        choice = getattr(config, kind)
        if choice is not None:
            default_registry().build_choice(kind, choice)


def _video(file: Path) -> bytes:
    """Six frames of a pattern that moves."""
    pixels = (
        np.random.default_rng(0)
        .integers(0, 255, (12, 30, 3), dtype=np.uint8)
        .repeat(8, 0)
        .repeat(8, 1)
    )
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter_fourcc(*"mp4v"), 12, (128, 96))
    for x in range(0, 96, 16):
        writer.write(np.ascontiguousarray(pixels[:, x : x + 128]))
    writer.release()
    return file.read_bytes()


def _png(pixels: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return buffer.getvalue()


def _cameras() -> Cameras:
    intrinsics = torch.tensor([[0.9, 0, 0.5], [0, 1.2, 0.5], [0, 0, 1]]).repeat(
        1, 2, 1, 1
    )
    return Cameras(torch.eye(4).repeat(1, 2, 1, 1), intrinsics, SIZE)


def _scene(count: int = 12) -> Gaussians:
    cloud = gaussian_cloud(count, degree=0)
    return replace(cloud, view_index=torch.arange(count) % 2)


def _sound(gaussians: Gaussians) -> None:
    """Finite, in range, and written and read again the same."""
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        assert torch.isfinite(getattr(gaussians, name)).all(), name
    assert (
        (gaussians.scales >= 0).all()
        and (gaussians.opacities <= 1).all()
        and (gaussians.opacities >= 0).all()
    )
    assert len(gaussians.view_index) == gaussians.count


def _network():
    torch.manual_seed(0)
    network = torch.nn.Linear(3, 2)
    return network, torch.optim.Adam(network.parameters())


def _cache_entry(folder: Path) -> bytes:
    cache = Cache()
    cache.recall(
        "match",
        "0",
        lambda: Views(
            torch.rand(1, 2, 3, 4, 4), torch.eye(3).repeat(1, 2, 1, 1), ("a", "b")
        ),
    )
    cache.save(folder)
    return next(folder.iterdir()).read_bytes()


def _earlier_run(run: Path, cameras: Cameras, scene: Gaussians, photos) -> object:
    """The folder of a finished run; returns what its run.json says."""
    for kind in ("inputs", "edited"):
        (run / kind).mkdir(parents=True)
        for name, image in zip(("a", "b"), photos.views.images[0]):
            save_image(image, run / kind / f"{name}.png")
    save_ply(run / "scene.ply", scene)
    write_cameras(
        run / "cameras.json", posed_cameras(cameras, ["inputs/a.png", "inputs/b.png"])
    )
    views = {
        "names": ["a", "b"],
        "intrinsics": cameras.intrinsics[0].tolist(),
        "c2w": cameras.c2w[0].tolist(),
    }
    tree = {
        "notes": {
            "views": {**views, "assumed": [False, False]},
            "edits": ["paint it red"],
        },
        "settings": {
            "run": {
                "reconstructor": {"name": "edit3r", "settings": {"size": 32}},
                "matcher": {"name": "classical", "settings": {}},
                "frames": 8,
            }
        },
        "inputs": recorded(list(photos.photos)),
    }
    (run / "run.json").write_text(json.dumps(tree))
    return tree
