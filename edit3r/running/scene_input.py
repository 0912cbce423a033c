"""A scene in place of photos: read, looked at, and written again as it came."""

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.reporting import available_memory, say
from edit3r.contract.types import Cameras, Gaussians, Reconstruction
from edit3r.kit.files.atomic import sha256_of
from edit3r.kit.files.names import unique_names
from edit3r.kit.geometry.cameras import to_pixels
from edit3r.kit.photos.camera_files import read_scene_cameras
from edit3r.kit.photos.framing import Frame
from edit3r.kit.photos.images import Photo, evenly
from edit3r.kit.scenes.axes import rotated
from edit3r.kit.scenes.files import LOOSE, is_loose_sog
from edit3r.kit.scenes.look import camera_file_of
from edit3r.kit.scenes.reading import form_of, load_scene
from edit3r.kit.scenes.rewriting import SceneChange, rewritten
from edit3r.kit.scenes.scene_views import (
    UPS,
    Places,
    SceneViews,
    as_given,
    look_around,
    pictures_of,
)
from edit3r.kit.scenes.spz_header import GZIP

SCENE_ENDINGS = (".ply", ".spz", ".sog", ".splat", ".ksplat", ".glb")
USUAL_VIEWS = 8
USUAL_SIZE = 384  # of the longer side of a picture [pixels]
BYTES_OF_ONE = 1200  # that a run holds for a Gaussian (benchmarks/splats.py large)
NAME = "the given scene"
ZSTD = "spz of zstd"  # SPZ from version 4 on


@dataclass(frozen=True)
class SceneInput:
    """The scene of a run, as it came and as it is looked at."""

    given: Gaussians  # in its own frame and unit
    views: SceneViews
    places: Places
    file: Path | None = None  # None: it came from memory

    @property
    def called(self) -> str:
        return NAME if self.file is None else str(self.file)

    @property
    def form(self) -> str:
        """Its format, as `edit3r.kit.scenes.reading.form_of` calls it; "spz of zstd" is SPZ 4."""
        if self.file is None:
            return "ply"
        form = form_of(self.file)
        if form == "spz" and not self.file.read_bytes().startswith(GZIP):
            return ZSTD
        return form

    @property
    def suffix(self) -> str:
        """How the name of a file of its format ends."""
        form = {ZSTD: "spz", "ksplat": "ply"}.get(self.form, self.form)
        return f".{form}"

    def records(self) -> tuple[Photo, ...]:
        """Its pictures as photos that are used whole."""
        cameras = self.places.cameras
        height, width = cameras.image_size
        frame = Frame((height, width), (0.0, 0.0, width, height), (height, width))
        digest = _digest(self.given) if self.file is None else sha256_of(self.file)
        focal = to_pixels(cameras.intrinsics[0], cameras.image_size)
        return tuple(
            Photo(
                name=name,
                file=self.called,
                sha256=digest,
                size=(height, width),
                frame=frame,
                intrinsics_source=f"a place {self.places.how} the scene",
                focal=(float(lens[0, 0]), float(lens[1, 1])),
            )
            for name, lens in zip(self.places.names, focal)
        )

    def in_own_frame(self, gaussians: Gaussians) -> Gaussians:
        """Gaussians of the run in the scene's own frame and unit."""
        c2w, unit = self.views.c2w, self.views.unit
        back = rotated(gaussians, c2w[:3, :3])
        means = back.means * unit + c2w[:3, 3].to(back.means)
        return replace(back, means=means, scales=back.scales * unit)

    def cameras_in_own_frame(self, cameras: Cameras) -> Cameras:
        """Cameras of the run in the scene's own frame and unit."""
        c2w = cameras.c2w.clone()
        c2w[..., :3, 3] *= self.views.unit
        return replace(cameras, c2w=self.views.c2w.to(c2w) @ c2w)

    def edited(self, made: Reconstruction, final: Gaussians) -> Gaussians:
        """The edited scene in its own frame; what did not change has the bits it came with."""
        change = self._change(made, final)
        if change is None:
            return self.in_own_frame(final)
        harmonics = self.given.harmonics.clone()
        harmonics[0, change.changed, 0] = torch.from_numpy(change.plain).to(harmonics)
        further = harmonics[0, change.changed, 1:]
        if not change.keeps_shine:
            shine = torch.from_numpy(change.shine).to(harmonics)
            harmonics[0, change.changed, 1:] = further @ shine.T
        kept = replace(self.given, harmonics=harmonics).select(
            torch.from_numpy(change.kept)
        )
        return kept if change.added is None else Gaussians.cat([kept, change.added])

    def content(self, made: Reconstruction, final: Gaussians) -> bytes | None:
        """The file with the edit in it; None where all of it has to be written anew."""
        change = None if self.file is None else self._change(made, final)
        if change is None:
            return None
        assert self.file is not None
        return rewritten(self.file, change)

    def _change(self, made: Reconstruction, final: Gaussians) -> SceneChange | None:
        """What an edit in place changed; None where the Gaussians were made anew."""
        kept = made.kept
        if kept is None or final is not made.gaussians:
            return None
        count = int(kept.sum())
        before = self.views.scene.gaussians.harmonics[0, kept]
        after = final.harmonics[0, :count]
        differs = (before != after).flatten(1).any(1)
        changed = torch.zeros_like(kept)
        changed[kept.nonzero()[:, 0][differs]] = True
        added = None
        if final.count > count:
            added = self.in_own_frame(final.select(torch.arange(count, final.count)))
        return SceneChange(
            kept=kept.numpy(),
            changed=changed.numpy(),
            plain=after[differs, 0].numpy(),
            shine=_mixed(before[differs, 1:], after[differs, 1:]),
            added=added,
        )


def is_scene(path: str | Path) -> bool:
    """Whether a path is that of a scene's file, by its name."""
    path = Path(path)
    if path.is_dir():
        return False
    return path.suffix.lower() in SCENE_ENDINGS or (
        path.name == LOOSE and is_loose_sog(path)
    )


def make_scene_input(
    scene: Path | Gaussians,
    rasterizer: Rasterizer,
    *,
    views: int | None = None,
    size: int | None = None,
    up: str | None = None,
    cameras: str | Path | Cameras | None = None,
) -> SceneInput:
    """The scene, and pictures of it from given cameras, those beside its file, or around it.

    `cameras` may be "none": not even those beside the file. Raises InputError for a file without
    Gaussians, a scene too large for the memory, an `up` that is no axis, and cameras that see
    nothing of it.
    """
    if up is not None and up not in UPS:
        raise InputError(
            f"--up {up}: a given scene keeps its axes; expected which of them points up, one of "
            f"{', '.join(UPS)}."
        )
    file = scene if isinstance(scene, Path) else None
    given = _checked(scene) if isinstance(scene, Gaussians) else load_scene(scene)
    _check_memory(given, NAME if file is None else str(file))
    with torch.no_grad():
        places = _places(given, file, rasterizer, views, size, up, cameras)
        pictures = pictures_of(given, places, rasterizer)
        share = pictures.scene.alphas[0].mean((1, 2))
        seen = (share > 0.002).nonzero()[:, 0].tolist()
        if len(seen) < places.cameras.count and places.how == "given":
            names = tuple(places.names[view] for view in seen)
            places = replace(places, cameras=places.cameras.select(seen), names=names)
            pictures = pictures_of(given, places, rasterizer)
    x, y, z = places.up
    say(
        "scene.places",
        f"{places.cameras.count} pictures from places {places.how} the scene; up is "
        f"({x:.2g}, {y:.2g}, {z:.2g})",
    )
    return SceneInput(given, pictures, places, file)


def _places(
    given: Gaussians,
    file: Path | None,
    rasterizer: Rasterizer,
    views: int | None,
    size: int | None,
    up: str | None,
    cameras: str | Path | Cameras | None,
) -> Places:
    longer = size or USUAL_SIZE
    beside = camera_file_of(file) if file is not None and cameras is None else None
    source = cameras or beside
    if source is None or str(source) == "none":
        square = (longer, longer)
        count = views or USUAL_VIEWS
        return look_around(given, rasterizer, count=count, size=square, up=up)
    if isinstance(source, Cameras):
        there, names = source, [f"view_{k + 1}" for k in range(source.count)]
    else:
        there, posed = read_scene_cameras(source)
        names = unique_names([Path(one.file).stem for one in posed])
    chosen = evenly(range(there.count), views or USUAL_VIEWS)
    there, names = there.select(chosen), [names[one] for one in chosen]
    share = min(1.0, longer / max(there.image_size))
    height, width = (max(1, round(share * side)) for side in there.image_size)
    return as_given(there.at((height, width)), names)


def _checked(scene: Gaussians) -> Gaussians:
    if scene.means.shape[0] != 1:
        raise InputError(
            f"{NAME}: a run edits one scene, got a batch of {scene.means.shape[0]}."
        )
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        if not bool(torch.isfinite(getattr(scene, name)).all()):
            raise InputError(f"{NAME}: has {name} that are not finite.")
    if not scene.count or float(scene.opacities.max()) < 1 / 255:
        raise InputError(
            f"{NAME}: shows nothing; it has no Gaussian with an opacity of at least 1/255."
        )
    return scene.to("cpu")


def _check_memory(gaussians: Gaussians, name: str) -> None:
    """Raise InputError, before any work, for a scene that this machine's memory cannot hold."""
    free = available_memory()
    needed = gaussians.count * BYTES_OF_ONE
    if free is not None and needed > free:
        raise InputError(
            f"{name}: {gaussians.count:,} Gaussians need about {needed / 1e9:.1f} GB, and "
            f"{free / 1e9:.1f} GB are free; make it smaller first: edit3r simplify."
        )


def _mixed(
    before: Float[Tensor, "gaussian coefficient 3"],
    after: Float[Tensor, "gaussian coefficient 3"],
) -> Float[np.ndarray, "3 3"]:
    """The matrix [new, old] that made `after` of `before`; the identity where they are equal."""
    if torch.equal(before, after):
        return np.eye(3)
    old, new = before.reshape(-1, 3).double(), after.reshape(-1, 3).double()
    found = torch.linalg.lstsq(old, new).solution
    return np.asarray(found.T)


def _digest(gaussians: Gaussians) -> str:
    found = hashlib.sha256()
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        found.update(getattr(gaussians, name).contiguous().numpy().tobytes())
    return found.hexdigest()
