"""Contract of a segmenter."""

import torch
from torch import Tensor

from edit3r.interfaces import Proposal, Segmenter, Tracks
from edit3r.testing.contract import Contract
from edit3r.testing.scenes import photograph

LOST = "set present to False and keep the logits of a lost object at or below 0"


class SegmenterContract(Contract):
    """Proposal fields in range, object numbers persistent through views, lost objects reported."""

    kind = "segmenter"
    subject: Segmenter
    image_size: tuple[int, int] = (72, 96)  # (height, width) [pixels]

    def test_proposals_are_in_range(self) -> None:
        image = self._photos()[0]
        proposals = self.call("propose()", self.subject.propose, image)
        self.require(
            isinstance(proposals, tuple),
            f"propose() returned a {type(proposals).__name__}; return a tuple of Proposal.",
        )
        for index, proposal in enumerate(proposals):
            self._check_proposal(f"proposal {index}", proposal)

    def test_a_blank_picture_is_no_error(self) -> None:
        image = torch.full((3, *self.image_size), 0.5, device=self.device)
        for index, proposal in enumerate(self.call("propose() of a grey picture", self.subject.propose, image)):
            self._check_proposal(f"proposal {index} on a grey picture", proposal)

    def test_a_point_and_a_box_give_one_object(self) -> None:
        image, ball = self._photos()[0], self._masks()[0]
        points, box = [_centre(ball)], _box(ball)
        for what, found in (
            ("segment(points=...)", self.call("segment(points=...)", self.subject.segment, image, points)),
            ("segment(box=...)", self.call("segment(box=...)", self.subject.segment, image, (), box)),
        ):
            self._check_proposal(what, found)

    def test_tracks_have_the_promised_shape(self) -> None:
        images, masks = self._photos(), self._masks()
        tracks = self._track(images, masks)
        views, objects = images.shape[0], masks.shape[0]
        self.require_tensor("Tracks.logits", tracks.logits, (views, objects, *self.image_size))
        self.require_tensor("Tracks.present", tracks.present, (views, objects), torch.bool)

    def test_object_numbers_persist(self) -> None:
        """Object r of the answer is object r of the masks given on view 0."""
        images, masks = self._photos(), self._masks()
        tracks = self._track(images, masks)
        for given in range(masks.shape[0]):
            inside = (tracks.logits[0] > 0).float()
            overlap = [(_iou(inside[found], masks[given])).item() for found in range(masks.shape[0])]
            best = max(range(len(overlap)), key=overlap.__getitem__)
            self.require(
                best == given and overlap[given] > 0.5,
                f"on view 0, object {given} of the masks overlaps the tracks by {overlap}; "
                "keep the order of the masks and return the given mask itself on view 0.",
            )

    def test_lost_objects_are_reported(self) -> None:
        """On a picture that shows nothing of the scene, every object is lost."""
        images = self._photos()
        images[1] = 0
        tracks = self._track(images, self._masks())
        self.require(not tracks.present[1].any(), f"objects are present on a black picture; {LOST}.")
        lost = tracks.logits[~tracks.present]
        self.require(not (lost > 0).any(), f"a lost object has logits above 0; {LOST}.")
        self.require(
            tracks.present[0].all(), "an object is lost on view 0, where its mask was given; report it present."
        )

    def _photos(self) -> Tensor:
        return photograph(2, self.image_size).views.images[0].to(self.device)

    def _masks(self) -> Tensor:
        """The two balls on view 0."""
        return photograph(2, self.image_size).objects[:, 0, 0].to(self.device)

    def _track(self, images: Tensor, masks: Tensor) -> Tracks:
        tracks = self.call("track()", self.subject.track, images, masks)
        self.require(isinstance(tracks, Tracks), f"track() returned a {type(tracks).__name__}; return Tracks.")
        return tracks

    def _check_proposal(self, name: str, proposal: Proposal) -> None:
        self.require(isinstance(proposal, Proposal), f"{name} is a {type(proposal).__name__}; return a Proposal.")
        self.require_tensor(f"{name}.soft_mask", proposal.soft_mask, self.image_size)
        self.require_range(f"{name}.soft_mask", proposal.soft_mask, 0, 1, "return probabilities, not logits")
        for field in ("area", "stability", "predicted_iou"):
            value = float(getattr(proposal, field))
            self.require(0 <= value <= 1, f"{name}.{field} is {value:.4g}; it is a share, in [0, 1].")
        covered = (proposal.soft_mask > 0.5).float().mean().item()
        self.require(
            abs(proposal.area - covered) < 0.01,
            f"{name}.area is {proposal.area:.4g}, but soft_mask > 0.5 covers {covered:.4g}; area is that share.",
        )
        x, y, width, height = proposal.box
        rows, columns = self.image_size
        fits = x >= 0 and y >= 0 and width >= 0 and height >= 0 and x + width <= columns + 1 and y + height <= rows + 1
        self.require(
            fits, f"{name}.box is {proposal.box} on a picture of {columns}x{rows}; it is (x, y, w, h) in pixels."
        )


def _centre(mask: Tensor) -> tuple[float, float]:
    """Normalised (x, y) of the middle of a mask."""
    ys, xs = torch.nonzero(mask, as_tuple=True)
    return (xs.float().mean().item() + 0.5) / mask.shape[1], (ys.float().mean().item() + 0.5) / mask.shape[0]


def _box(mask: Tensor) -> tuple[float, float, float, float]:
    """Normalised (x, y, w, h) around a mask."""
    ys, xs = torch.nonzero(mask, as_tuple=True)
    left, top, right, bottom = xs.min().item(), ys.min().item(), xs.max().item() + 1, ys.max().item() + 1
    height, width = mask.shape
    return left / width, top / height, (right - left) / width, (bottom - top) / height


def _iou(first: Tensor, second: Tensor) -> Tensor:
    return torch.minimum(first, second).sum() / torch.maximum(first, second).sum().clamp(min=1)
