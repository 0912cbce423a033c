"""Contracts of what changes and finds things in images: editor, segmenter and detector."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import (
    SUBJECT,
    Detector,
    Editor,
    MaskLogits,
    Segmenter,
    Tracks,
)
from edit3r.contract.types import EditRequest, Views
from edit3r.kit import asking
from edit3r.kit.geometry.maps import composite
from edit3r.running import instructions_for
from edit3r_testing.contract import Contract


class EditorContract(Contract):
    """Keeps number, size, range, dtype and cameras of the views; same seed, same result."""

    kind = "editor"
    subject: Editor
    prompt: str = "make it warmer"  # an instruction the editor can carry out
    # True: the editor changes what is masked, and needs masks for it
    masked: bool = False

    def views(self, count: int = 2, **scene: Any) -> Views:
        """Test photos, as many as the component's declaration allows."""
        if self.offer is not None:
            about = self.offer.component
            count = max(count, about.min_views)
            count = min(count, about.max_views or count)
        return self.scene(count, **scene).views

    def edit(
        self,
        views: Views,
        masks: Float[Tensor, "batch view height width"] | None = None,
    ) -> Views:
        """One edit that keeps what the pipeline checks."""
        if masks is None and self.masked:
            masks = torch.ones_like(views.images[:, :, 0])
        instructions = instructions_for(self.subject, self.prompt)
        for instruction in instructions:
            self.ask(asking.understands, instruction)
        if masks is not None:
            self.ask(asking.widened, masks[None], views.images)
        request = EditRequest(self.prompt, 3, masks, instructions)
        return self.ask(asking.edit, views, request)

    def test_keeps_size_dtype_and_range(self) -> None:
        height, width = self.image_size
        for size in ((height, width), (height + 1, width - 3)):
            views = self.views(size=size)
            views.images[..., :8, :] = 0  # black and white show what is not clamped
            views.images[..., 8:16, :] = 1
            self.edit(views)

    def test_keeps_cameras_and_names(self) -> None:
        views = self.views()
        names = tuple(f"photo-{i}" for i in range(views.count))
        edited = self.edit(Views(views.images, views.intrinsics, names))
        fix = "return dataclasses.replace(views, images=...) so that cameras and names stay"
        self.require_equal(
            "intrinsics changed", edited.intrinsics, views.intrinsics, fix
        )
        self.require(
            edited.names == names,
            f"names changed from {names} to {edited.names}; {fix}.",
        )

    def test_any_number_of_views_and_scenes(self) -> None:
        for count in (1, 3, 5):
            self.edit(self.views(count))
        self.edit(self.views(batch=2))

    def test_same_seed_gives_the_same_result(self) -> None:
        if self.offer is not None and not self.offer.component.supports_seed:
            return
        views = self.views()
        fix = "draw from torch.Generator().manual_seed(request.seed), or say supports_seed=False"
        self.require_same_twice(lambda: self.edit(views).images, "seed", fix)

    def test_leaves_its_inputs_alone(self) -> None:
        views = self.views()
        self.require_untouched(views.images, lambda: self.edit(views))

    def test_pixels_outside_the_masks_stay_after_the_composite(self) -> None:
        """The pipeline blends the edit into the photos; the editor must accept masks."""
        views = self.views()
        masks = torch.zeros_like(views.images[:, :, 0])
        masks[..., : views.image_size[0] // 2, :] = 1
        blended = composite(views.images, self.edit(views, masks).images, masks)
        outside = masks[:, :, None].expand_as(blended) == 0
        self.require_equal(
            "pixels outside the masks changed",
            blended[outside],
            views.images[outside],
            "return finite images of the size given",
        )


LOST = "set present to False and keep the logits of a lost object at or below 0"


class SegmenterContract(Contract):
    """Masks for clicks, boxes and corrections; object numbers persistent through views, lost
    objects reported.
    """

    kind = "segmenter"
    subject: Segmenter
    image_size = (72, 96)

    def test_a_click_and_a_box_give_masks(self) -> None:
        image, box = self._photos()[0], _box(self._masks()[0])
        centre = (box[0] + box[2] / 2, box[1] + box[3] / 2)
        by_click = self._ask("masks() of a click", image, [(centre, True)])
        self._ask("masks() of a box", image, (), box)
        more = [(centre, True), ((0.02, 0.02), False)]
        self._ask("masks() of a correction", image, more, None, by_click.logits[0])

    def test_a_blank_image_is_no_error(self) -> None:
        self._ask("masks() of a grey image", _grey(self), [((0.5, 0.5), True)])

    def test_words_give_masks_or_nothing(self) -> None:
        """None for words that it does not know."""
        image = self._photos()[0]
        for text in ("ball", SUBJECT, "qwertzblorf"):
            self.ask(asking.words, image, text)

    def test_tracks_have_the_promised_shape(self) -> None:
        images, masks = self._photos(), self._masks()
        self._track(images, masks)

    def test_object_numbers_persist(self) -> None:
        """Object r of the answer is object r of the masks given on view 0."""
        masks = self._masks()
        tracks = self._track(self._photos(), masks)
        if tracks is None:
            return
        found = (tracks.logits[0] > 0).float()
        both = torch.einsum("fhw,ghw->fg", found, masks)
        either = found.sum((1, 2))[:, None] + masks.sum((1, 2)) - both
        overlaps = both / either.clamp(min=1)  # intersection over union
        right = overlaps.argmax(0) == torch.arange(len(masks), device=self.device)
        self.require(
            right.all() and overlaps.diagonal().min() > 0.5,
            f"on view 0, the tracks overlap the masks by {overlaps.tolist()}; keep the order of "
            "the masks and return the given mask itself on view 0.",
        )

    def test_lost_objects_are_reported(self) -> None:
        """On an image that shows nothing of the scene, every object is lost."""
        images = self._photos()
        images[1] = 0
        tracks = self._track(images, self._masks())
        if tracks is None:
            return
        self.require(
            not tracks.present[1].any(),
            f"objects are present on a black image; {LOST}.",
        )
        lost = tracks.logits[~tracks.present]
        self.require(not (lost > 0).any(), f"a lost object has logits above 0; {LOST}.")
        self.require(
            tracks.present[0].all(),
            "an object is lost on view 0, where its mask was given; report it present.",
        )

    def _photos(self) -> Float[Tensor, "view 3 height width"]:
        return self.scene().views.images[0]

    def _masks(self) -> Float[Tensor, "object height width"]:
        """The two balls on view 0."""
        return self.scene().objects[:, 0, 0]

    def _ask(self, what: str, *asked: Any) -> MaskLogits:
        answer = self.ask(asking.masks, *asked)
        if answer.quality is not None:
            fix = "it is an expected IoU"
            self.require_range(f"{what}: quality", answer.quality, -0.1, 1.1, fix)
        return answer

    def _track(
        self,
        images: Float[Tensor, "view 3 height width"],
        masks: Float[Tensor, "object height width"],
    ) -> Tracks | None:
        return self.ask(asking.track, images, masks)


def _grey(contract: "SegmenterContract | DetectorContract") -> Tensor:
    return torch.full((3, *contract.image_size), 0.5, device=contract.device)


def _box(mask: Float[Tensor, "height width"]) -> tuple[float, float, float, float]:
    """Normalised (x, y, w, h) around a mask."""
    height, width = mask.shape
    y, x = torch.nonzero(mask, as_tuple=True)
    left, right = x.min().item() / width, (x.max().item() + 1) / width
    top, bottom = y.min().item() / height, (y.max().item() + 1) / height
    return left, top, right - left, bottom - top


class DetectorContract(Contract):
    """Boxes inside the image, scores in [0, 1], best first; nothing found is an empty tuple."""

    kind = "detector"
    subject: Detector
    text: str = "the ball"  # what to look for
    image_size = (72, 96)

    def test_detections_are_in_range_and_sorted(self) -> None:
        self._check(self.scene().views.images[0, 0])

    def test_a_blank_image_is_no_error(self) -> None:
        self._check(_grey(self))

    def _check(self, image: Float[Tensor, "3 height width"]) -> None:
        self.ask(asking.detect, image, self.text)
