from dataclasses import dataclass

import pytest
import torch
from edit3r_recolor.editor import RecolorEditor

from edit3r.errors import InputError, PromptError, SettingsError
from edit3r.interfaces import Proposal, Segmenter, Tracks
from edit3r.pipeline import composite
from edit3r.registry import build
from edit3r.reporting import Report, collecting
from edit3r.types import EditRequest, Views

HEIGHT, WIDTH = 12, 16


@dataclass
class LeftHalf(Segmenter):
    """The left half of the first view is the object; `found_in` are the views it is found in, `text` what it reads."""

    found_in: tuple[int, ...] = (0, 1)
    text: tuple | None = None
    empty: bool = False

    def _proposal(self, image) -> Proposal:
        mask = torch.zeros(image.shape[-2:])
        mask[:, : WIDTH // 2] = 1
        return Proposal(mask, 0.5, 1.0, 1.0, (0, 0, WIDTH // 2, HEIGHT))

    def propose(self, image):
        return () if self.empty else (self._proposal(image),)

    def segment(self, image, points=(), box=None):
        self.asked = (tuple(points), box)
        return self._proposal(image)

    def track(self, images, masks):
        logits = (20 * masks - 10).expand(len(images), -1, -1, -1).clone()
        present = torch.tensor([[view in self.found_in] for view in range(len(images))])
        return Tracks(torch.where(present[..., None, None], logits, logits.clamp(max=-1)), present)

    def segment_text(self, image, text):
        return None if self.text is None else tuple(self._proposal(image) for t in self.text if t == text)


def photos(batch: int = 1) -> Views:
    images = torch.rand(batch, 2, 3, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(0))
    return Views(0.2 + 0.6 * images, torch.eye(3).expand(batch, 2, 3, 3), ("a", "b"))


def edit(
    prompt: str, segmenter: Segmenter | None = None, masks=None, seed: int = 0, views=None, guess=True, **settings
):
    editor = RecolorEditor(RecolorEditor.Settings(**settings), segmenter or LeftHalf())
    report = Report()
    with collecting(report):
        edited = editor.edit(views or photos(), EditRequest(prompt, seed, masks, guess))
    return edited.images, report


def changed(images: torch.Tensor) -> torch.Tensor:
    """Bool [B, V, H, W]: which pixels differ from the photos."""
    return (images - photos(len(images)).images).abs().amax(2) > 1e-4


def test_pixels_outside_the_given_mask_are_bit_equal():
    masks = torch.zeros(1, 2, HEIGHT, WIDTH)
    masks[..., :5, :] = 1
    images, report = edit("paint the bike red", masks=masks)
    assert torch.equal(images[..., 5:, :], photos().images[..., 5:, :])
    assert changed(images)[..., :5, :].all()
    assert report.notes["editor.region"] == "masks"


def test_a_soft_mask_blends_once_between_photo_and_colour():
    full = edit("paint it red", masks=torch.ones(1, 2, HEIGHT, WIDTH))[0]
    masks = torch.full((1, 2, HEIGHT, WIDTH), 0.5)
    half = composite(photos().images, edit("paint it red", masks=masks)[0], masks)  # as the pipeline does
    assert torch.allclose(half, 0.5 * full + 0.5 * photos().images, atol=1e-6)


def test_an_object_is_taken_from_the_segmenter_and_said_to_be_a_guess():
    images, report = edit("paint the bike red")
    assert changed(images)[..., : WIDTH // 2].all()
    assert torch.equal(images[..., WIDTH // 2 :], photos().images[..., WIDTH // 2 :])
    assert report.notes["editor.region"] == "most salient object"
    assert "a guess" in report.warnings[0] and "--mask" in report.warnings[0]


def test_without_leave_to_guess_unknown_words_are_an_error_with_the_way_out():
    with pytest.raises(InputError, match=r"'bike' is not a word .*--point.*--guess"):
        edit("paint the bike red", guess=False)


def test_words_are_looked_up_where_the_segmenter_reads_them():
    _, report = edit("paint the bike red", LeftHalf(text=("bike",)))
    assert report.notes["editor.region"] == "named object" and not report.warnings
    with pytest.raises(InputError, match="'house' was not found"):
        edit("paint the house red", LeftHalf(text=("bike",)), guess=False)


def test_a_lost_object_is_reported_and_keeps_its_colours():
    images, report = edit("paint the bike red", LeftHalf(found_in=(0,)))
    assert changed(images)[:, 0].any() and torch.equal(images[:, 1], photos().images[:, 1])
    assert any("not found again on photo 2" in warning for warning in report.warnings)


def test_global_words_change_the_whole_picture():
    images, report = edit("make it darker")
    assert changed(images).all() and report.notes["editor.region"] == "everything"


def test_the_background_is_all_but_the_object():
    images, _ = edit("make the background darker")
    assert changed(images)[..., WIDTH // 2 :].all() and not changed(images)[:, 0, :, : WIDTH // 2].any()


def test_the_background_of_a_marked_object_is_all_but_that():
    images, report = edit("make the background darker", point=(0.2, 0.5))
    assert changed(images)[..., WIDTH // 2 :].all() and not changed(images)[:, 0, :, : WIDTH // 2].any()
    assert report.notes["editor.region"] == "all but the point"


@pytest.mark.parametrize("mark", [{"point": (0.2, 0.5)}, {"box": (0.1, 0.1, 0.5, 0.5)}])
def test_a_marked_object_is_handed_to_the_segmenter(mark):
    segmenter = LeftHalf()
    _, report = edit("darker", segmenter, **mark)
    assert report.notes["editor.region"] == next(iter(mark))
    assert segmenter.asked == (((0.2, 0.5),), None) if "point" in mark else ((), (0.1, 0.1, 0.5, 0.5))


def test_without_any_object_the_error_says_how_to_mark_one():
    with pytest.raises(InputError, match=r"nothing stands out.*--point"):
        edit("paint the bike red", LeftHalf(empty=True))


def test_an_empty_prompt_samples_from_the_seed_and_notes_the_parameters():
    first, report = edit("", seed=3)
    assert torch.equal(first, edit("", seed=3)[0]) and not torch.equal(first, edit("", seed=4)[0])
    assert set(report.notes["editor.parameters"]) >= {"hue", "gamma", "permutation"}


def test_strength_mixes_with_the_photo():
    assert torch.equal(edit("make it darker", strength=0.0)[0], photos().images)
    half, full = edit("make it darker", strength=0.5)[0], edit("make it darker")[0]
    assert torch.allclose(half, 0.5 * full + 0.5 * photos().images, atol=1e-6)


def test_scenes_of_a_batch_are_edited_one_by_one():
    both = edit("paint the bike red", views=photos(2))[0]
    assert both.shape == (2, 2, 3, HEIGHT, WIDTH)
    single = Views(photos(2).images[1:], photos(2).intrinsics[1:])
    assert torch.equal(both[1:], edit("paint the bike red", views=single)[0])


def test_what_was_understood_is_noted():
    understood = edit("paint the bike red")[1].notes["editor.understood"]
    assert understood["subject"] == "bike" and understood["steps"][0]["colour"] == "red"


def test_a_prompt_it_cannot_read_is_an_error():
    with pytest.raises(PromptError):
        edit("turn it into a castle")


def test_a_point_outside_the_picture_is_a_settings_error():
    with pytest.raises(SettingsError, match=r"editor\.point.*\[0, 1\]"):
        build("editor", "recolor", point=[3, 0.5])
