"""How much of an edit is taken, and how softly it begins inside the outline."""

import pytest
import torch

from edit3r.contract.errors import SettingsError
from edit3r.kit.geometry.maps import feathered
from edit3r.kit.photos.images import load_photos, packaged_pair
from edit3r.running import RunJob, make_run_config, preview_photo


@pytest.fixture(scope="module")
def photos():
    return load_photos(packaged_pair()[0], size=48).views


def edited(photos, **settings):
    masks = torch.zeros(1, 2, *photos.image_size)
    masks[..., 8:24, 10:40] = 1
    config = make_run_config(
        {"prompt": "paint it blue", "editor": "recolor", **settings}
    )
    return preview_photo(RunJob(config, photos, masks=masks)).images, masks[0]


def test_strength_takes_a_share_of_the_edit(photos):
    whole, _ = edited(photos)
    half, _ = edited(photos, strength=0.5)
    none, _ = edited(photos, strength=0)
    assert torch.equal(none, photos.images) and not torch.equal(whole, photos.images)
    torch.testing.assert_close(half, (whole + photos.images) / 2)


def test_a_feather_fades_in_inside_and_leaves_the_outside_alone(photos):
    whole, masks = edited(photos)
    soft, _ = edited(photos, feather=5)
    change = (soft - photos.images).abs().sum(2)[0]
    full = (whole - photos.images).abs().sum(2)[0]
    assert change[masks == 0].max() == 0
    assert change[0, 8:9, 10:40].mean() < 0.3 * full[0, 8:9, 10:40].mean()
    torch.testing.assert_close(
        soft[0, 0, :, 15:17, 20:30], whole[0, 0, :, 15:17, 20:30]
    )


def test_the_border_of_a_photo_is_no_outline():
    masks = torch.zeros(2, 12, 12)
    masks[0, :, :6] = 1
    masks[1] = 1
    weights = feathered(masks, 4)
    assert weights[0, :, 0].min() == 1 and 0 < weights[0, 6, 5] < 0.3
    assert weights[1].min() == 1
    assert feathered(torch.zeros(1, 4, 4), 3).max() == 0


@pytest.mark.parametrize("wrong", [{"strength": 1.1}, {"feather": -1}])
def test_other_numbers_are_refused(wrong):
    with pytest.raises(SettingsError):
        make_run_config(wrong)
