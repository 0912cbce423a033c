"""What Python hands to a run and cannot be used is one sentence, at the door."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.types import Cameras, Views
from edit3r.running.given import check_cameras, check_views, checked_masks


@pytest.fixture
def views():
    images = torch.rand(1, 2, 3, 8, 10, generator=torch.Generator().manual_seed(0))
    lens = torch.tensor([[0.8, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]])
    poses = torch.eye(4).repeat(1, 2, 1, 1)
    poses[0, 1, 0, 3] = 0.3
    return Views(images, lens.repeat(1, 2, 1, 1), c2w=poses)


def with_value(tensor, place, value):
    changed = tensor.clone()
    changed[place] = value
    return changed


IMAGES = {
    "NaN": (lambda x: with_value(x, (0, 1, 2, 3, 4), torch.nan), "1 of 480 values"),
    "infinite": (lambda x: with_value(x, (0, 0, 0, 0, 0), torch.inf), "not finite"),
    "float64": (lambda x: x.double(), r"got float64.*\.to\(torch.float32\)"),
    "float16": (lambda x: x.half(), "got float16"),
    "bfloat16": (lambda x: x.bfloat16(), "got bfloat16"),
    "uint8": (lambda x: (255 * x).byte(), "got uint8.*/ 255"),
    "bool": (lambda x: x > 0.5, "got bool"),
    "0 to 255": (lambda x: x / x.amax() * 255, "to 255, .* divide by 255"),
    "negative": (lambda x: x - 0.5, "from -0.4.*clamp"),
    "a little above 1": (lambda x: x + 0.01, "clamp"),
    "no view": (lambda x: x[:, :0], "holds nothing"),
    "no pixel": (lambda x: x[..., :0], "holds nothing"),
}


@pytest.mark.parametrize(("change", "words"), IMAGES.values(), ids=IMAGES)
def test_images(views, change, words):
    images = change(views.images)
    count = images.shape[1]
    given = replace(
        views.select(range(count)),
        images=images,
    )
    with pytest.raises(InputError, match=rf"^Views.images: .*{words}"):
        check_views(given)


MATRICES = {
    "a NaN lens": ("intrinsics", (0, 1, 0, 0), torch.nan, "1 of 18 values"),
    "a focal length of 0": ("intrinsics", (0, 0, 1, 1), 0, r"\[0, 0\].*expected above 0"),
    "a negative one": ("intrinsics", (0, 1, 0, 0), -0.8, r"\[0, 1\].*expected above 0"),
    "one in pixels": ("intrinsics", (0, 0, 0, 0), 500, "as in pixels"),
    "skew": ("intrinsics", (0, 0, 0, 1), 0.4, "pinhole"),
    "a NaN pose": ("c2w", (0, 1, 2, 3), torch.nan, "1 of 32 values"),
    "a pose that scales": ("c2w", (0, 1, slice(3), slice(3)), 2 * torch.eye(3), "no rotation"),
    "one that mirrors": ("c2w", (0, 1, 0, 0), -1, "mirrors"),
    "a pose of zeros": ("c2w", (0, 1), 0, r"\[0, 1\]"),
    "world to nothing": ("c2w", (0, 0, 3, 0), 1, "last row"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("field", "place", "value", "words"), MATRICES.values(), ids=MATRICES
)
def test_lenses_and_poses(views, field, place, value, words):
    wrong = with_value(getattr(views, field), place, value)
    with pytest.raises(InputError, match=rf"^Views.{field}.*{words}"):
        check_views(replace(views, **{field: wrong}))
    with pytest.raises(InputError, match=rf"^Views.{field}: got float64"):
        check_views(replace(views, **{field: getattr(views, field).double()}))
    cameras = replace(Cameras(views.c2w, views.intrinsics, (8, 10)), **{field: wrong})
    with pytest.raises(InputError, match=rf"^Cameras.{field}"):
        check_cameras(cameras, views)


def test_cameras_of_fewer_views_than_there_are(views):
    cameras = Cameras(views.c2w, views.intrinsics, (8, 10)).select([0])
    with pytest.raises(InputError, match="1 scenes of 1 views, expected"):
        check_cameras(cameras, views)


def test_good_views_and_masks_pass(views):
    check_views(views)
    check_cameras(Cameras(views.c2w, views.intrinsics, (8, 10)), views)
    masks = views.images[:, :, 0]
    assert checked_masks(masks) is masks
    assert checked_masks(masks > 0.5).dtype == torch.float32


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda x: (255 * x).byte(), "got uint8"),
        (lambda x: 3 * x, "expected float32 in"),
        (lambda x: x / 0 - x / 0, "not finite"),
    ],
)
def test_masks(views, change, words):
    with pytest.raises(InputError, match=rf"^masks: .*{words}"):
        checked_masks(change(views.images[:, :, 0]))


def test_a_run_looks_at_all_of_it_first(views):
    with pytest.raises(InputError, match=r"^Views.images"):
        edit3r.run(replace(views, images=2 * views.images))
    bent = replace(Cameras(views.c2w, views.intrinsics, (8, 10)), c2w=2 * views.c2w)
    with pytest.raises(InputError, match=r"^Cameras.c2w"):
        edit3r.run(views, cameras=bent)
    with pytest.raises(InputError, match=r"^masks"):
        edit3r.run(views, masks=2 + views.images[:, :, 0])
    with pytest.raises(InputError, match=r"^photos: .*expected files, arrays"):
        edit3r.run(views.images)
    with pytest.raises(InputError, match=r"^masks: got ndarray, expected files or"):
        edit3r.run(views, masks=np.zeros((1, 2, 8, 10)))
