import numpy as np
import pytest
import torch

from edit3r.contract.interfaces import OtherCandidates
from edit3r.kit.contact_sheet import draw_sheet, with_candidates


def flat(views, size, colour):
    return torch.tensor(colour)[None, :, None, None].expand(views, 3, *size).clone()


def drawn(views, size, **texts):
    """A sheet whose photos are red, edits green and results blue."""
    colours = ([1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0])
    images = (flat(views, size, colour) for colour in colours)
    return draw_sheet(dict(zip(("photo", "2D edit", "3D result"), images)), **texts)


def share(sheet, colour):
    return (np.asarray(sheet) == np.array(colour)).all(-1).mean()


@pytest.mark.parametrize("views", [1, 2, 3, 5, 8])
@pytest.mark.parametrize("size", [(256, 256), (512, 288), (200, 500)])
def test_every_view_shows_photo_edit_and_result_at_one_size(views, size):
    sheet = drawn(views, size, title="a prompt", subtitle="editor none")
    shares = [
        share(sheet, colour) for colour in ([255, 0, 0], [0, 255, 0], [0, 0, 255])
    ]
    assert shares[0] == shares[1] == shares[2] > 0.12
    assert max(sheet.size) < 2900


def test_images_keep_their_shape():
    sheet = np.asarray(drawn(1, (100, 300)))
    red = (sheet == [255, 0, 0]).all(-1)
    assert red.any(0).sum() == pytest.approx(3 * red.any(1).sum(), abs=2)


@pytest.mark.parametrize(
    "title", ["", "word " * 400, "x" * 2000, "größer, 更红, 🎨", "two\nlines"]
)
def test_any_prompt_fits(title):
    sheet = drawn(2, (64, 64), title=title, names=["a very long photo name " * 20, ""])
    assert share(sheet, [255, 0, 0]) > 0.05 and sheet.height < 2000


@pytest.mark.parametrize("size", [(1, 1), (1, 1000), (900, 2)])
def test_extreme_shapes_are_drawn(size):
    assert drawn(2, size).width > 100


def test_all_that_else_may_be_meant_is_shown_whole_below_a_narrow_sheet():
    yellow = OtherCandidates(
        flat(1, (64, 64), [1.0, 1.0, 0])[0],
        "a",
        {f"--candidate {number}": torch.zeros(64, 64) for number in range(2, 10)},
    )
    sheet = with_candidates(drawn(1, (256, 256)), [yellow])
    shown = share(sheet, [255, 255, 0]) * sheet.width * sheet.height
    assert shown == pytest.approx(8 * 256**2)
    assert share(sheet, [255, 0, 0]) > 0


def test_mismatched_counts_are_an_error():
    with pytest.raises(ValueError, match="as many images of each kind as views"):
        draw_sheet(
            {"photo": flat(2, (4, 4), [0.0] * 3), "edit": flat(1, (4, 4), [0.0] * 3)}
        )
