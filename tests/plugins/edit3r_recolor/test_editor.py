from dataclasses import dataclass

import pytest
import torch
from edit3r_recolor.editor import RecolorEditor

from edit3r.contract.interfaces import Proposal, Segmenter, Tracks
from edit3r.contract.types import EditRequest, Views
from edit3r.errors import InputError, PromptError, SettingsError
from edit3r.pipeline.steps import composite
from edit3r.plugins.registry import build
from edit3r.reporting import Report, collecting

HEIGHT, WIDTH = 12, 16


@dataclass
class LeftHalf(Segmenter):
    """The left half of the first view is the object; `found_in` are the views it is found in,
    `text` what it reads.
    """

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
        return Tracks(
            torch.where(present[..., None, None], logits, logits.clamp(max=-1)), present
        )

    def segment_text(self, image, text):
        return (
            None
            if self.text is None
            else tuple(self._proposal(image) for t in self.text if t == text)
        )


def photos(batch: int = 1) -> Views:
    images = torch.rand(
        batch, 2, 3, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(0)
    )
    return Views(0.2 + 0.6 * images, torch.eye(3).expand(batch, 2, 3, 3), ("a", "b"))


def edit(
    prompt: str,
    segmenter: Segmenter | None = None,
    masks=None,
    seed: int = 0,
    views=None,
    guess=True,
    **settings,
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
    half = composite(
        photos().images, edit("paint it red", masks=masks)[0], masks
    )  # as the pipeline does
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
    assert changed(images)[:, 0].any() and torch.equal(
        images[:, 1], photos().images[:, 1]
    )
    assert any("not found again on photo 2" in warning for warning in report.warnings)


def test_global_words_change_the_whole_picture():
    images, report = edit("make it darker")
    assert changed(images).all() and report.notes["editor.region"] == "everything"


def test_the_background_is_all_but_the_object():
    images, _ = edit("make the background darker")
    assert (
        changed(images)[..., WIDTH // 2 :].all()
        and not changed(images)[:, 0, :, : WIDTH // 2].any()
    )


def test_the_background_of_a_marked_object_is_all_but_that():
    images, report = edit("make the background darker", point=(0.2, 0.5))
    assert (
        changed(images)[..., WIDTH // 2 :].all()
        and not changed(images)[:, 0, :, : WIDTH // 2].any()
    )
    assert report.notes["editor.region"] == "all but the point"


@pytest.mark.parametrize("mark", [{"point": (0.2, 0.5)}, {"box": (0.1, 0.1, 0.5, 0.5)}])
def test_a_marked_object_is_handed_to_the_segmenter(mark):
    segmenter = LeftHalf()
    _, report = edit("darker", segmenter, **mark)
    assert report.notes["editor.region"] == next(iter(mark))
    assert (
        segmenter.asked == (((0.2, 0.5),), None)
        if "point" in mark
        else ((), (0.1, 0.1, 0.5, 0.5))
    )


def test_without_any_object_the_error_says_how_to_mark_one():
    with pytest.raises(InputError, match=r"nothing stands out.*--point"):
        edit("paint the bike red", LeftHalf(empty=True))


def test_recolouring_without_a_colour_samples_from_the_seed_and_notes_the_parameters():
    first, report = edit("recolor it", seed=3)
    assert torch.equal(first, edit("recolor it", seed=3)[0]) and not torch.equal(
        first, edit("recolor it", seed=4)[0]
    )
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
    notes = edit("paint the bike red")[1].notes
    (understood,) = notes["editor.understood"]
    assert (
        understood["subject"] == ("bike",) and understood["steps"][0]["colour"] == "red"
    )
    assert (understood["read"], understood["words"]) == ("bike: red", ("bike", "red"))
    assert notes["edit.understood"] == "bike: red (words: bike, red)"


class Halves(LeftHalf):
    """Knows the left half and the right half by name."""

    def segment_text(self, image, text):
        if text not in ("left", "right"):
            return ()
        mask = self._proposal(image).soft_mask
        return (
            Proposal(
                mask if text == "left" else 1 - mask,
                0.5,
                1.0,
                1.0,
                (0, 0, WIDTH, HEIGHT),
            ),
        )


def test_two_things_get_their_own_colours():
    images, report = edit("paint the left red and the right green", Halves())
    left, right = (
        images[..., : WIDTH // 2].mean((0, 1, 3, 4)),
        images[..., WIDTH // 2 :].mean((0, 1, 3, 4)),
    )
    assert left.argmax() == 0 and right.argmax() == 1
    assert torch.equal(
        images[..., : WIDTH // 2],
        edit("paint the left red", Halves())[0][..., : WIDTH // 2],
    )
    assert len(report.notes["editor.region_share"]) == 2


@pytest.mark.parametrize("place", ["masks", "point", "segmenter"])
def test_two_things_and_one_place_is_an_error_that_says_so(place):
    masks = torch.ones(1, 2, HEIGHT, WIDTH) if place == "masks" else None
    segmenter = LeftHalf(text=("bike",))
    segmenter.prompt = "bike" if place == "segmenter" else ""
    more = {"point": (0.2, 0.5)} if place == "point" else {}
    with pytest.raises(
        PromptError, match=r"several places .*door: green; wall: white.*--from"
    ):
        edit("paint the door green and the wall white", segmenter, masks, **more)


def test_two_changes_of_one_place_need_no_second_mask():
    edit("paint it red and darker", masks=torch.ones(1, 2, HEIGHT, WIDTH))


def test_everything_except_the_object_changes():
    images, report = edit("paint everything except the left red", Halves())
    assert (
        changed(images)[..., WIDTH // 2 :].all()
        and not changed(images)[..., : WIDTH // 2].any()
    )
    assert report.notes["editor.region"] == "all but the named object"


def test_a_photo_without_the_exception_stays_as_it_is():
    segmenter = Halves(found_in=(0,))
    images, report = edit("paint everything except the left red", segmenter)
    assert changed(images)[:, 0].any() and not changed(images)[:, 1].any()
    assert any("photo 2" in warning for warning in report.warnings)


def test_everything_except_and_a_given_mask_contradict_each_other():
    with pytest.raises(PromptError, match="say where the edit goes"):
        edit(
            "paint everything except the bear red",
            masks=torch.ones(1, 2, HEIGHT, WIDTH),
        )


def coloured() -> Views:
    """Left third grey of several tones, middle third dull red, right third blue."""
    images = torch.empty(1, 2, 3, HEIGHT, WIDTH)
    images[..., :5] = torch.linspace(0.35, 0.65, HEIGHT)[:, None]
    images[..., 5:10] = torch.tensor([0.55, 0.16, 0.14])[:, None, None]
    images[..., 10:] = torch.tensor([0.1, 0.25, 0.8])[:, None, None]
    return Views(images, torch.eye(3).expand(1, 2, 3, 3), ("a", "b"))


@pytest.mark.parametrize(("near", "third"), [("grey", 0), ("red", 1), ("blue", 2)])
def test_only_pixels_near_the_first_colour_change(near, third):
    views = coloured()
    for masks in (None, torch.ones(1, 2, HEIGHT, WIDTH)):
        images, _ = edit(f"from {near} to brown", views=views, masks=masks)
        moved = (images - views.images).abs().amax(2) > 0.02
        thirds = [
            moved[..., columns].float().mean()
            for columns in (slice(0, 5), slice(5, 10), slice(10, None))
        ]
        assert thirds == [float(index == third) for index in range(3)]


def test_colours_can_change_places():
    images, _ = edit("turn red into blue and blue into red", views=coloured())
    assert images[0, 0, :, 5, 7].argmax() == 2 and images[0, 0, :, 5, 14].argmax() == 0


def test_a_colour_that_is_not_there_is_an_error():
    with pytest.raises(PromptError, match="nothing there is near green"):
        edit("from green to brown", views=coloured())


def test_no_prompt_is_an_error():
    with pytest.raises(PromptError, match="nothing is asked for"):
        edit("")


def test_a_prompt_it_cannot_read_is_an_error():
    with pytest.raises(PromptError):
        edit("turn it into a castle")


def test_a_point_outside_the_picture_is_a_settings_error():
    with pytest.raises(SettingsError, match=r"editor\.point.*less than or equal to 1"):
        build("editor", "recolor", point=[3, 0.5])
