"""edit3r's contract of an editor, and what sepia does; run where edit3r and this package are
installed.
"""

import torch

import edit3r
from edit3r_testing import EditorContract


class TestSepiaKeepsTheContract(EditorContract):
    component = "sepia"


def photos() -> edit3r.Views:
    images = torch.rand(1, 2, 3, 8, 12, generator=torch.Generator().manual_seed(0))
    return edit3r.Views(images=images, intrinsics=torch.eye(3).expand(1, 2, 3, 3))


def test_sepia_makes_red_exceed_green_exceed_blue():
    red, green, blue = (
        edit3r.build("editor", "sepia")
        .edit(photos(), edit3r.EditRequest(""))
        .images.unbind(2)
    )
    assert (red >= green).all() and (green >= blue).all() and (red > blue).any()


def test_strength_0_returns_the_photos():
    edited = edit3r.build("editor", "sepia", strength=0).edit(
        photos(), edit3r.EditRequest("")
    )
    assert torch.equal(edited.images, photos().images)
