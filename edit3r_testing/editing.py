"""Contracts of what changes and finds things in images: editor, segmenter and detector."""

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import (
    Detection,
    Detector,
    Editor,
    Proposal,
    Segmenter,
    Tracks,
)
from edit3r.contract.types import EditRequest, Views
from edit3r.pipeline.steps import composite
from edit3r_testing.contract import Contract
from edit3r_testing.scenes import photograph


class EditorContract(Contract):
    """Keeps number, size, range, dtype and cameras of the views; same seed, same result."""

    kind = "editor"
    subject: Editor
    prompt: str = "make it warmer"  # an instruction the editor can carry out
    masked: bool = (
        False  # True: the editor changes what is masked, and needs masks for it
    )
    image_size: tuple[int, int] = (
        48,
        64,
    )  # (height, width) [pixels]; larger for an editor that needs it

    def views(
        self,
        view_count: int | None = None,
        batch: int = 1,
        image_size: tuple[int, int] | None = None,
    ) -> Views:
        """Test photos, as many as the component's declaration allows (2 by default)."""
        least, most = self._view_limits()
        count = min(max(view_count or 2, least), most)
        return photograph(count, image_size or self.image_size, batch).views.to(
            self.device
        )

    def edit(
        self,
        views: Views,
        seed: int = 3,
        masks: Float[Tensor, "batch view height width"] | None = None,
    ) -> Views:
        """One edit; what it raises or returns that is no Views becomes a violation."""
        batch, count, _, height, width = views.images.shape
        if masks is None and self.masked:
            masks = views.images.new_ones(batch, count, height, width)
        what = f"edit() of {batch} x {count} photos of {height}x{width}"
        edited = self.call(
            what, self.subject.edit, views, EditRequest(self.prompt, seed, masks)
        )
        self.require_type("edit() returned", edited, Views, "edit3r.Views")
        return edited

    def test_keeps_size_dtype_and_range(self) -> None:
        for size in (self.image_size, (self.image_size[0] + 1, self.image_size[1] - 3)):
            views = self.views(image_size=size)
            edited = self.edit(views)
            self.require_tensor(
                "images of the edited views", edited.images, tuple(views.images.shape)
            )
            self.require_range(
                "images",
                edited.images,
                0,
                1,
                "clamp the result, for example with .clamp(0, 1)",
            )

    def test_keeps_cameras_and_names(self) -> None:
        views = self.views()
        views = Views(
            views.images,
            views.intrinsics,
            tuple(f"photo-{i}" for i in range(views.count)),
        )
        edited = self.edit(views)
        fix = "return dataclasses.replace(views, images=...) so that cameras and names stay"
        self.require_equal(
            "intrinsics changed", edited.intrinsics, views.intrinsics, fix
        )
        self.require(
            edited.names == views.names,
            f"names changed from {views.names} to {edited.names}; {fix}.",
        )

    def test_any_number_of_views_and_scenes(self) -> None:
        least, most = self._view_limits()
        for count in sorted({least, min(3, most), min(5, most)}):
            views = self.views(count)
            self.require_tensor(
                f"images edited from {count} views",
                self.edit(views).images,
                tuple(views.images.shape),
            )
        views = self.views(batch=2)
        self.require_tensor(
            "images edited from 2 scenes",
            self.edit(views).images,
            tuple(views.images.shape),
        )

    def test_same_seed_gives_the_same_result(self) -> None:
        if self.offer is not None and not self.offer.component.supports_seed:
            return
        views = self.views()
        first = self.edit(views)
        torch.rand(
            3
        )  # an editor that draws from the global generator would now draw something else
        fix = "draw from torch.Generator().manual_seed(request.seed), or declare supports_seed=False"
        self.require_equal(
            "the same seed gave two results",
            first.images,
            self.edit(views).images,
            fix,
            self.tolerance,
        )

    def test_leaves_its_inputs_alone(self) -> None:
        views = self.views()
        before = views.images.clone()
        self.edit(views)
        fix = "do not write into views.images; work on a copy"
        self.require_equal(
            "edit() changed the photos it was given", views.images, before, fix
        )

    def test_pixels_outside_the_masks_stay_after_the_composite(self) -> None:
        """The framework blends the edit into the photos by the masks; the editor must accept them
        and keep the size.
        """
        views = self.views()
        masks = torch.zeros(
            *views.images.shape[:2], *views.image_size, device=self.device
        )
        masks[..., : views.image_size[0] // 2, :] = 1
        edited = self.edit(views, masks=masks)
        self.require_tensor(
            "images edited under masks", edited.images, tuple(views.images.shape)
        )
        blended = composite(views.images, edited.images, masks)
        outside = masks[:, :, None].expand_as(blended) == 0
        fix = "return finite images of the size given"
        self.require_equal(
            "pixels outside the masks changed",
            blended[outside],
            views.images[outside],
            fix,
        )

    def _view_limits(self) -> tuple[int, int]:
        """Least and most views the declaration allows; 8 stands for any number."""
        if self.offer is None:
            return 1, 8
        return self.offer.component.min_views, self.offer.component.max_views or 8


LOST = "set present to False and keep the logits of a lost object at or below 0"


class SegmenterContract(Contract):
    """Proposal fields in range, object numbers persistent through views, lost objects reported."""

    kind = "segmenter"
    subject: Segmenter
    image_size: tuple[int, int] = (72, 96)  # (height, width) [pixels]

    def test_proposals_are_in_range(self) -> None:
        image = self._photos()[0]
        proposals = self.call("propose()", self.subject.propose, image)
        self.require_type("propose() returned", proposals, tuple, "a tuple of Proposal")
        for index, proposal in enumerate(proposals):
            self._check_proposal(f"proposal {index}", proposal)

    def test_a_blank_image_is_no_error(self) -> None:
        image = torch.full((3, *self.image_size), 0.5, device=self.device)
        for index, proposal in enumerate(
            self.call("propose() of a grey picture", self.subject.propose, image)
        ):
            self._check_proposal(f"proposal {index} on a grey picture", proposal)

    def test_a_point_and_a_box_give_one_object(self) -> None:
        image, ball = self._photos()[0], self._masks()[0]
        points, box = [_centre(ball)], _box(ball)
        for what, found in (
            (
                "segment(points=...)",
                self.call("segment(points=...)", self.subject.segment, image, points),
            ),
            (
                "segment(box=...)",
                self.call("segment(box=...)", self.subject.segment, image, (), box),
            ),
        ):
            self._check_proposal(what, found)

    def test_tracks_have_the_promised_shape(self) -> None:
        images, masks = self._photos(), self._masks()
        tracks = self._track(images, masks)
        views, objects = images.shape[0], masks.shape[0]
        self.require_tensor(
            "Tracks.logits", tracks.logits, (views, objects, *self.image_size)
        )
        self.require_tensor(
            "Tracks.present", tracks.present, (views, objects), torch.bool
        )

    def test_object_numbers_persist(self) -> None:
        """Object r of the answer is object r of the masks given on view 0."""
        images, masks = self._photos(), self._masks()
        tracks = self._track(images, masks)
        for given in range(masks.shape[0]):
            inside = (tracks.logits[0] > 0).float()
            overlap = [
                (_iou(inside[found], masks[given])).item()
                for found in range(masks.shape[0])
            ]
            best = max(range(len(overlap)), key=overlap.__getitem__)
            self.require(
                best == given and overlap[given] > 0.5,
                f"on view 0, object {given} of the masks overlaps the tracks by {overlap}; "
                "keep the order of the masks and return the given mask itself on view 0.",
            )

    def test_lost_objects_are_reported(self) -> None:
        """On an image that shows nothing of the scene, every object is lost."""
        images = self._photos()
        images[1] = 0
        tracks = self._track(images, self._masks())
        self.require(
            not tracks.present[1].any(),
            f"objects are present on a black picture; {LOST}.",
        )
        lost = tracks.logits[~tracks.present]
        self.require(not (lost > 0).any(), f"a lost object has logits above 0; {LOST}.")
        self.require(
            tracks.present[0].all(),
            "an object is lost on view 0, where its mask was given; report it present.",
        )

    def _photos(self) -> Float[Tensor, "view 3 height width"]:
        return photograph(2, self.image_size).views.images[0].to(self.device)

    def _masks(self) -> Float[Tensor, "object height width"]:
        """The two balls on view 0."""
        return photograph(2, self.image_size).objects[:, 0, 0].to(self.device)

    def _track(
        self,
        images: Float[Tensor, "view 3 height width"],
        masks: Float[Tensor, "object height width"],
    ) -> Tracks:
        tracks = self.call("track()", self.subject.track, images, masks)
        self.require_type("track() returned", tracks, Tracks, "Tracks")
        return tracks

    def _check_proposal(self, name: str, proposal: Proposal) -> None:
        self.require_type(f"{name} is", proposal, Proposal, "a Proposal")
        self.require_tensor(f"{name}.soft_mask", proposal.soft_mask, self.image_size)
        self.require_range(
            f"{name}.soft_mask",
            proposal.soft_mask,
            0,
            1,
            "return probabilities, not logits",
        )
        for field in ("area", "stability", "predicted_iou"):
            value = float(getattr(proposal, field))
            self.require(
                0 <= value <= 1,
                f"{name}.{field} is {value:.4g}; it is a share, in [0, 1].",
            )
        covered = (proposal.soft_mask > 0.5).float().mean().item()
        self.require(
            abs(proposal.area - covered) < 0.01,
            f"{name}.area is {proposal.area:.4g}, but soft_mask > 0.5 covers {covered:.4g}; area "
            "is that share.",
        )
        x, y, width, height = proposal.box
        rows, columns = self.image_size
        fits = (
            x >= 0
            and y >= 0
            and width >= 0
            and height >= 0
            and x + width <= columns + 1
            and y + height <= rows + 1
        )
        self.require(
            fits,
            f"{name}.box is {proposal.box} on a picture of {columns}x{rows}; it is (x, y, w, h) "
            "in pixels.",
        )


def _centre(mask: Float[Tensor, "height width"]) -> tuple[float, float]:
    """Normalised (x, y) of the middle of a mask."""
    ys, xs = torch.nonzero(mask, as_tuple=True)
    return (xs.float().mean().item() + 0.5) / mask.shape[1], (
        ys.float().mean().item() + 0.5
    ) / mask.shape[0]


def _box(mask: Float[Tensor, "height width"]) -> tuple[float, float, float, float]:
    """Normalised (x, y, w, h) around a mask."""
    ys, xs = torch.nonzero(mask, as_tuple=True)
    left, top, right, bottom = (
        xs.min().item(),
        ys.min().item(),
        xs.max().item() + 1,
        ys.max().item() + 1,
    )
    height, width = mask.shape
    return left / width, top / height, (right - left) / width, (bottom - top) / height


def _iou(
    first: Float[Tensor, "height width"], second: Float[Tensor, "height width"]
) -> Float[Tensor, ""]:
    """Intersection over union of two soft masks."""
    return torch.minimum(first, second).sum() / torch.maximum(
        first, second
    ).sum().clamp(min=1)


class DetectorContract(Contract):
    """Boxes inside the image, scores in [0, 1], best first; nothing found is an empty tuple."""

    kind = "detector"
    subject: Detector
    text: str = "the ball"  # what to look for
    image_size: tuple[int, int] = (72, 96)  # (height, width) [pixels]

    def test_detections_are_in_range_and_sorted(self) -> None:
        image = photograph(2, self.image_size).views.images[0, 0].to(self.device)
        self._check(image)

    def test_a_blank_image_is_no_error(self) -> None:
        self._check(torch.full((3, *self.image_size), 0.5, device=self.device))

    def _check(self, image: Float[Tensor, "3 height width"]) -> None:
        found = self.call(
            f"detect({self.text!r})", self.subject.detect, image, self.text
        )
        kind = type(found).__name__
        self.require(
            isinstance(found, tuple),
            f"detect() returned a {kind}; return a tuple, () for none.",
        )
        height, width = self.image_size
        for index, detection in enumerate(found):
            name = f"detection {index}"
            self.require_type(f"{name} is", detection, Detection, "Detection")
            self.require(
                0 <= detection.score <= 1,
                f"{name}.score is {detection.score:.4g}; it must lie in [0, 1].",
            )
            x, y, w, h = detection.box
            fits = (
                x >= 0
                and y >= 0
                and w > 0
                and h > 0
                and x + w <= width + 1
                and y + h <= height + 1
            )
            self.require(
                fits,
                f"{name}.box is {detection.box} on {width}x{height}; it is (x, y, w, h) in pixels.",
            )
        scores = [detection.score for detection in found]
        self.require(
            scores == sorted(scores, reverse=True),
            f"scores are {scores}; return the best first.",
        )
