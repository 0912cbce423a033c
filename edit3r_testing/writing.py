"""Contract of a writer."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch

from edit3r.contract.interfaces import (
    NamedObjects,
    OtherCandidates,
    SceneToWrite,
    SecondLook,
    Writer,
)
from edit3r.contract.types import Gaussians
from edit3r.kit import asking
from edit3r.kit.geometry.cameras import pixel_rays
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r.kit.photos.images import to_bytes
from edit3r.kit.rendering import render_each
from edit3r_testing.contract import Contract
from edit3r_testing.rasterizer import reference_rasterizer
from edit3r_testing.scenes import Photographed

NAMES = ("a photo <1>", "Ünïcode & more")
TITLE = 'paint the "bike" </script> red\nÜ'
DEGREES = (0, 4)  # of harmonics: the least and the most that there are


class WriterContract(Contract):
    """Writes one whole file or folder, the same bytes each time, of every scene there is."""

    kind = "writer"
    subject: Writer
    image_size = (12, 16)  # a Gaussian a pixel, which the plain rasterizer shows

    def scene_to_write(self, degree: int = 1) -> SceneToWrite:
        """A scene of which all is known: what a run knows, and what plugins add."""
        scene = self.scene()
        gaussians = _surface(scene, degree)
        render = partial(
            render_each, reference_rasterizer(), gaussians, text="look at the scene"
        )
        rendered = render(scene.cameras)
        look = SecondLook(torch.linspace(0, 1, 3 * gaussians.count).view(-1, 3))
        negative = replace(scene.views, images=1 - scene.views.images)
        masks = {"first": scene.objects[0, 0, 0], "second": scene.objects[0, 0, 0]}
        return SceneToWrite(
            gaussians=gaussians,
            cameras=scene.cameras,
            names=NAMES,
            photos=replace(scene.views, names=NAMES),
            edited=replace(negative, names=NAMES),
            masks=scene.objects[0, 0],
            candidates=(OtherCandidates(scene.views.images[0, 0], NAMES[0], masks),),
            rendered=rendered,
            title=TITLE,
            subtitle="a <subtitle>",
            about="editor none",
            second_look=lambda: look,
            objects=NamedObjects({"a ball": 0}, "edit3r objects {run} remove {name}"),
            render=render,
            frames=lambda: (to_bytes(image) for image in rendered.images[0]),
            up=(0.0, -1.0, 0.0),
            unit="m",
        )

    @contextmanager
    def written(self, scene: SceneToWrite) -> Iterator[Path]:
        """What the writer leaves of a scene, until the block ends."""
        name = self.subject.offer.component.file_name()
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / name
            self.ask(asking.write, path, scene)
            yield path

    def test_writes_the_one_file_or_folder_that_it_is_given(self) -> None:
        """Whole when `write` ends, and nothing beside it."""
        with self.written(self.scene_to_write()) as path:
            beside = sorted(one.name for one in path.parent.iterdir() if one != path)
            self.require(not beside, f"it leaves {', '.join(beside)} beside its path.")

    def test_same_scene_gives_the_same_bytes(self) -> None:
        """Dates, random numbers and the order of sets do not belong into a file."""
        scene = self.scene_to_write()
        with self.written(scene) as first, self.written(scene) as path:
            before, after = _bytes_of(first), _bytes_of(path)
            other = [name for name in after if before.get(name) != after[name]]
            self.require(
                before == after,
                f"the same scene gave other bytes the second time ({', '.join(other)}).",
            )

    def test_takes_harmonics_of_every_degree(self) -> None:
        """A format without them leaves them out, and says so in `loses`."""
        for degree in DEGREES:
            with self.written(self.scene_to_write(degree)):
                pass

    def test_needs_what_it_says_and_no_more(self) -> None:
        """A scene that has only the Gaussians and what the writer `needs` is written."""
        whole = self.scene_to_write()
        needed = {name: getattr(whole, name) for name in self.subject.needs}
        least = SceneToWrite(**{**needed, "gaussians": whole.gaussians})
        with self.written(least):
            pass

    def test_leaves_its_inputs_alone(self) -> None:
        scene = self.scene_to_write()
        before = deepcopy(scene.gaussians)
        with self.written(scene):
            fix = "work on a copy"
            self.require_equal("its input was changed", scene.gaussians, before, fix)


def _surface(scene: Photographed, degree: int) -> Gaussians:
    """A Gaussian for each pixel where it was seen, with objects and uncertainty."""
    height, width = scene.cameras.image_size
    rays = pixel_rays(scene.cameras.intrinsics[0, 0], (height, width))
    c2w = scene.cameras.c2w[0]
    places = rays * scene.depths[0, ..., None]
    means = torch.einsum("vij,vhwj->vhwi", c2w[:, :3, :3], places)
    means = (means + c2w[:, None, None, :3, 3]).reshape(1, -1, 3)
    count = means.shape[1]
    colours = scene.views.images[0].permute(0, 2, 3, 1).reshape(1, count, 1, 3)
    rest = torch.linspace(-0.1, 0.1, count * 3 * ((degree + 1) ** 2 - 1))
    sizes = scene.depths[0].reshape(1, count, 1).expand(-1, -1, 3) / width
    return Gaussians(
        means=means,
        scales=sizes.contiguous(),
        quats=torch.tensor([1.0, 0, 0, 0]).repeat(1, count, 1),
        opacities=torch.full((1, count), 0.9),
        harmonics=torch.cat((colour_to_dc(colours), rest.view(1, count, -1, 3)), 2),
        view_index=torch.arange(2).repeat_interleave(count // 2),
        object_index=scene.objects[0, 0].flatten().long() - 1,
        uncertainty=torch.linspace(0, 1, count)[None],
    )


def _bytes_of(path: Path) -> dict[str, bytes]:
    """The content of a file, or of each file of a folder."""
    if path.is_file():
        return {path.name: path.read_bytes()}
    files = sorted(file for file in path.rglob("*") if file.is_file())
    return {str(file.relative_to(path)): file.read_bytes() for file in files}
