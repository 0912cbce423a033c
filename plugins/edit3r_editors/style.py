"""The editor `style`: photos, or what is selected of them, in the style of a picture.

Of the picture one style vector is computed, by which a small network draws each photo. What it
draws has strokes that know nothing of the other photos, and would blur in 3D. So one function is
fitted to all drawings of a scene: from what a pixel's photo shows around it to the colour drawn
there. The photos are coloured by that function, which answers alike wherever a surface looks alike,
at any size; strokes that depend on nothing the photo shows average out in it.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float
from PIL import Image, ImageOps
from pydantic import Field
from torch import Tensor

import edit3r
from edit3r.contract.errors import InputError, PromptError
from edit3r.contract.instructions import Instruction, Target
from edit3r.contract.interfaces import Editor, EditsRegions
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.compute.layers import one_thread
from edit3r.kit.files.names import expanded
from edit3r.kit.photos.images import read_image
from edit3r.kit.weights.find import find
from edit3r.kit.weights.onnx import onnx_session, require_onnx_file, run_onnx
from edit3r_editors import ANY_STYLE

Pixels = Float[np.ndarray, "height width 3"]
Vector = Float[np.ndarray, "1 1 1 style"]
Function = Callable[[Float[np.ndarray, "pixel feature"]], Float[np.ndarray, "pixel 3"]]

# sides of what the two networks take, fixed in their files [pixels]
DRAWN, SEEN = 384, 256
PICTURES = frozenset(("picture", "painting", "image", "photo", "artwork", "drawing"))
"""Words by which a sentence means the picture that is given with it."""

NO_PICTURE = (
    "needs the picture whose style is meant: --editor style --set editor.picture=FILE."
)

# The numbers of this block: docs/notes/style.md.
# blurs that tell what is around a pixel, where a side is DRAWN [pixels]
AROUND = (1, 2, 4, 8)
WAVES = 256  # random cosines that the function is a sum of
FREQUENCY = 1.5  # their standard deviation [radians over the range of a feature]
DETAIL = 3.0  # how much more a difference of two blurs counts than a colour
SAMPLE = 20_000  # pixels that the function is fitted to
RIDGE = 1.0
AT_ONCE = 1 << 16  # pixels that are coloured at once: 70 MB


class StyleEditor(Editor, EditsRegions):
    """Gives photos, or what is selected of them, the style of a picture."""

    class Settings(edit3r.Settings):
        picture: str = ""
        """image file whose style is taken"""
        strength: float = Field(1.0, ge=0, le=1)
        """share of the style; 0 returns the photo"""
        strokes: float = Field(0.0, ge=0, le=1)
        """share of the strokes of each photo's own drawing, which disagree and blur in 3D"""
        predict: str = ""
        """ONNX file that makes a style vector of a picture; empty: that of the weights"""
        transform: str = ""
        """ONNX file that draws a photo by a style vector; empty: likewise"""

    settings: Settings

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._picture: Image.Image | None = None
        file = settings.picture
        self._picture = read_image(expanded(file)) if file else None
        if bool(settings.predict) != bool(settings.transform):
            raise InputError(
                "style: give both files, predict and transform, or neither."
            )
        if settings.predict:
            self._predict, self._transform = (
                expanded(settings.predict),
                expanded(settings.transform),
            )
        else:
            folder = find(ANY_STYLE)
            self._predict, self._transform = (
                folder / ANY_STYLE.stored(path) for path, _ in ANY_STYLE.files
            )

    def understands(self, instruction: Instruction) -> bool:
        """A look that means a picture, or any look where the picture is given."""
        named = bool(PICTURES & {*instruction.look.split()})
        return instruction.action == "look" and (named or bool(self.settings.picture))

    def instruction_of_nothing(self) -> Instruction | None:
        text = "in the style of the picture"
        if self._picture is None:
            raise PromptError(f"style {NO_PICTURE}")
        return Instruction("look", Target("whole"), look="picture", text=text)

    @one_thread()
    def edit(self, views: Views, request: EditRequest) -> Views:
        if self._picture is None:
            raise PromptError(f"{request.prompt!r} {NO_PICTURE}")
        vector = _answer(self._predict, _square(self._picture))
        draw = _network(self._transform)
        styled = torch.stack(
            [self._scene(images, draw, vector, request.seed) for images in views.images]
        )
        weight: float | Tensor = self.settings.strength
        if request.regions is not None:
            weight = weight * request.regions.amax(0)[:, :, None].to(styled)
        weight = torch.as_tensor(weight).to(styled)
        return replace(views, images=torch.lerp(views.images, styled, weight))

    def _scene(
        self,
        images: Float[Tensor, "view 3 height width"],
        draw: Callable[..., np.ndarray],
        vector: Vector,
        seed: int,
    ) -> Float[Tensor, "view 3 height width"]:
        photos = images.permute(0, 2, 3, 1).numpy(force=True).astype(np.float32)
        small = [_fitted(photo) for photo in photos]
        drawn = [_drawn(draw, photo, vector) for photo in small]
        function = _one_function(small, drawn, np.random.default_rng(seed))
        styled = [_by_pixels(function, photo) for photo in photos]
        if self.settings.strokes:
            styled = [
                colours + self.settings.strokes * _enlarged(own - alike, colours)
                for colours, own, alike in zip(
                    styled, drawn, [_by_pixels(function, photo) for photo in small]
                )
            ]
        pixels = torch.from_numpy(np.stack(styled)).clamp(0, 1)
        return pixels.permute(0, 3, 1, 2).to(images)


# ---- one function of what is around a pixel ----


def _one_function(
    photos: list[Pixels], drawn: list[Pixels], draw: np.random.Generator
) -> Function:
    """Ridge regression of the drawings on random cosines of features (Rahimi and Recht 2007)."""
    features = np.concatenate([_features(photo) for photo in photos])
    colours = np.concatenate([one.reshape(-1, 3) for one in drawn])
    count = features.shape[1]
    waves = FREQUENCY * draw.normal(size=(count, WAVES)).astype(np.float32)
    phases = draw.uniform(0, 2 * np.pi, WAVES).astype(np.float32)

    def terms(features):
        one = np.ones_like(features[:, :1])
        return np.hstack((np.cos(features @ waves + phases), features, one))

    kept = draw.permutation(len(features))[:SAMPLE]
    known = terms(features[kept])
    normal = known.T @ known + RIDGE * np.eye(known.shape[1], dtype=np.float32)
    weights = np.linalg.solve(normal, known.T @ colours[kept])
    return lambda features: terms(features) @ weights


def _by_pixels(function: Function, photo: Pixels) -> Pixels:
    features = _features(photo)
    parts = np.array_split(features, -(-len(features) // AT_ONCE))
    return np.concatenate([function(part) for part in parts]).reshape(photo.shape)


def _features(photo: Pixels) -> Float[np.ndarray, "pixel feature"]:
    """Bands of a photo's colours from fine to coarse, and the slopes of its light."""
    unit = max(photo.shape[:2]) / DRAWN
    blurred = [photo, *(cv2.GaussianBlur(photo, (0, 0), unit * one) for one in AROUND)]
    bands = [DETAIL * (fine - coarse) for fine, coarse in pairwise(blurred)]
    slopes = []
    for image, reach in zip(blurred[1:-1], AROUND):
        light = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        down, across = np.gradient(light)
        steep = DETAIL * unit * reach * np.stack((across, down), -1)
        slopes += [steep, np.linalg.norm(steep, axis=-1, keepdims=True)]
    return np.concatenate((blurred[-1], *bands, *slopes), -1).reshape(
        photo[..., 0].size, -1
    )


# ---- the two networks ----


def _square(picture: Image.Image) -> Pixels:
    """The middle of a picture, as the network of style vectors takes it."""
    square = ImageOps.fit(picture, (SEEN, SEEN), Image.Resampling.LANCZOS)
    return np.asarray(square, np.float32) / 255


def _fitted(photo: Pixels) -> Pixels:
    """A photo whose longer side is DRAWN."""
    height, width = (
        max(1, round(side * DRAWN / max(photo.shape[:2]))) for side in photo.shape[:2]
    )
    shrinks = max(photo.shape[:2]) > DRAWN
    way = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return cv2.resize(photo, (width, height), interpolation=way)


def _enlarged(image: Pixels, like: Pixels) -> Pixels:
    return cv2.resize(image, like.shape[1::-1], interpolation=cv2.INTER_CUBIC)


def _drawn(draw: Callable[..., np.ndarray], photo: Pixels, vector: Vector) -> Pixels:
    """A photo of at most DRAWN by the network, which takes a square: it is mirrored to fill it."""
    height, width = photo.shape[:2]
    square = np.pad(photo, ((0, DRAWN - height), (0, DRAWN - width), (0, 0)), "reflect")
    return draw(square[None], vector)[0, :height, :width]


def _answer(path: Path, picture: Pixels) -> Vector:
    return _network(path)(picture[None])


def _network(path: Path) -> Callable[..., np.ndarray]:
    """The first output of an ONNX file as a function of its inputs; InputError for another file."""
    require_onnx_file(path)
    session = onnx_session(
        path, path.read_bytes(), f"fetch it again with: {ANY_STYLE.get}."
    )
    names = [one.name for one in session.get_inputs()]

    def answer(*values: np.ndarray) -> np.ndarray:
        (first, *_) = run_onnx(
            session,
            path,
            None,
            dict(zip(names, values)),
            fault=f"is none of the two networks of {ANY_STYLE.name}",
            advice="expected a picture of 256 pixels to a style vector, and a photo of 384 and "
            "that vector to a drawing.",
        )
        return first

    return answer
