from pathlib import Path

import numpy as np
import pytest
import torch
from edit3r_editors.folder import read_edit
from PIL import Image, ImageOps

from edit3r.contract.errors import InputError, SettingsError
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.photos.images import save_image
from edit3r.loading.registry import build
from edit3r_testing import Contract, EditorContract, claims

VIEWS = Views(
    torch.rand(1, 2, 3, 6, 8), torch.eye(3).expand(1, 2, 3, 3), ("left", "right")
)


def flat(level: float, height: int = 6, width: int = 8) -> torch.Tensor:
    return torch.full((3, height, width), round(level * 255) / 255)


def edit(folder: Path, views: Views = VIEWS) -> tuple[torch.Tensor, Report]:
    with collecting(Report()) as report:
        edited = build("editor", "folder", path=str(folder)).edit(
            views, EditRequest("")
        )
    return edited.images[0], report


def test_pictures_are_matched_by_name_whatever_their_order_and_suffix(tmp_path):
    save_image(flat(0.2), tmp_path / "right.png")
    save_image(flat(0.8), tmp_path / "Left.webp")
    images, report = edit(tmp_path)
    assert torch.allclose(images[0], flat(0.8), atol=0.02) and torch.equal(
        images[1], flat(0.2)
    )
    assert report.warnings == []


def test_pictures_without_the_views_names_are_matched_in_natural_order_and_that_is_said(
    tmp_path,
):
    save_image(flat(0.2), tmp_path / "out10.png")
    save_image(flat(0.8), tmp_path / "out9.png")
    images, report = edit(tmp_path)
    assert torch.equal(images[0], flat(0.8)) and torch.equal(images[1], flat(0.2))
    assert "left <- out9.png, right <- out10.png" in report.warnings[0]


def test_another_size_is_resampled(tmp_path):
    save_image(flat(0.4, 12, 16), tmp_path / "left.png")
    save_image(flat(0.6, 3, 4), tmp_path / "right.png")
    images, report = edit(tmp_path)
    assert (
        torch.equal(images, torch.stack((flat(0.4), flat(0.6))))
        and report.warnings == []
    )


def test_another_shape_is_cropped_around_its_middle_and_that_is_said(tmp_path):
    wide = flat(0.0, 6, 16)
    wide[:, :, 4:12] = 1
    save_image(wide, tmp_path / "left.png")
    save_image(flat(0.5), tmp_path / "right.png")
    images, report = edit(tmp_path)
    assert (images[0] == 1).all()
    assert "left.png is 16x6 but view 'left' is 8x6" in report.warnings[0]


@pytest.mark.parametrize(
    ("kind", "said"),
    {
        "squashed": "squashed to lie on its photo",
        "turned": "turned by 90 degrees to lie on its photo",
        "cropped": "25% is cropped away",
        "with bars": "25% is cropped away",
    }.items(),
)
def test_pictures_of_another_shape_lie_on_their_photos(tmp_path, kind, said):
    """A model returns 1024x1024 whatever it was given; programs forget what EXIF told to turn."""
    coarse = np.random.default_rng(0).integers(0, 255, (9, 12, 3), dtype=np.uint8)
    photo = Image.fromarray(coarse).resize((96, 72), Image.Resampling.BICUBIC)
    edited = photo.point(lambda level: 0.7 * level)
    square = {
        "squashed": edited.resize((128, 128)),
        "turned": edited.transpose(Image.Transpose.ROTATE_270),
        "cropped": ImageOps.fit(edited, (128, 128)),
        "with bars": ImageOps.pad(edited, (128, 128)),
    }[kind]
    square.save(tmp_path / "left.png")
    like = torch.from_numpy(np.array(photo)).permute(2, 0, 1) / 255
    with collecting(Report()) as report:
        found = read_edit(tmp_path / "left.png", like, "left")
    assert said in report.warnings[0]
    off = (found - 0.7 * like).abs().mean().item()
    assert (off < 0.02) == (kind != "cropped")  # of which nobody knows the rest


@pytest.mark.parametrize("name", ["{} (edited)", "ComfyUI_{}_00001_", "{}-flux"])
def test_names_that_hold_the_photos_are_matched(tmp_path, name):
    levels = {"right": 0.2, "left": 0.4}
    for place, (view, level) in enumerate(levels.items()):
        save_image(flat(level), tmp_path / f"{place}_{name.format(view)}.png")
    images, report = edit(tmp_path)
    assert [round(float(image.mean()), 1) for image in images] == [0.4, 0.2]
    assert not report.warnings


def test_a_small_picture_is_said_to_be_enlarged(tmp_path):
    save_image(flat(0.2, 2, 3), tmp_path / "left.png")
    save_image(flat(0.2), tmp_path / "right.png")
    _, report = edit(tmp_path)
    assert "left.png is 3x2" in report.warnings[0]
    assert "enlarged 3.0 times" in report.warnings[0]


def test_a_missing_view_is_named(tmp_path):
    save_image(flat(0.2), tmp_path / "left.png")
    with pytest.raises(InputError, match=r"no picture for 'right'; found left\.png"):
        edit(tmp_path)


def test_a_wrong_number_of_pictures_is_an_error(tmp_path):
    for name in "abc":
        save_image(flat(0.2), tmp_path / f"{name}.png")
    with pytest.raises(InputError, match="3 pictures cannot be matched to 2 views"):
        edit(tmp_path)


def test_two_pictures_of_one_name_are_an_error(tmp_path):
    for name in ("left.png", "left.jpg", "right.png"):
        save_image(flat(0.2), tmp_path / name)
    with pytest.raises(InputError, match=r"left\.jpg, left\.png all fit one view"):
        edit(tmp_path)


def test_an_unreadable_picture_is_named(tmp_path):
    save_image(flat(0.2), tmp_path / "left.png")
    (tmp_path / "right.png").write_bytes(b"not a picture")
    with pytest.raises(InputError, match=r"right\.png"):
        edit(tmp_path)


@pytest.mark.parametrize(
    "path, error", [("", SettingsError), ("/nowhere/at/all", InputError)]
)
def test_a_folder_must_be_given_and_exist(path, error):
    with pytest.raises(error, match=r"editor\.path"):
        build("editor", "folder", path=path).edit(VIEWS, EditRequest(""))


def test_an_empty_folder_is_an_error(tmp_path):
    with pytest.raises(InputError, match="no images"):
        edit(tmp_path)


class FolderContract(EditorContract):
    """The folder holds an image for each photo that is asked for."""

    component = "folder"

    def edit(self, views, masks=None):
        for old in Path(self.settings["path"]).iterdir():
            old.unlink()
        for index, image in enumerate(views.images[0]):
            name = views.names[index] if views.names else str(index)
            save_image(1 - image, Path(self.settings["path"]) / f"{name}.png")
        return super().edit(views, masks)

    def test_any_number_of_views_and_scenes(self) -> None:
        """Of views alone: a folder holds the images of one scene."""
        for count in (1, 3, 5):
            self.edit(self.views(count))


@pytest.mark.parametrize(
    "claim", sorted({*claims(EditorContract)} - {*claims(Contract)})
)
def test_contract(tmp_path, claim):
    contract = type("Bound", (FolderContract,), {"settings": {"path": str(tmp_path)}})
    getattr(contract(), claim)()
