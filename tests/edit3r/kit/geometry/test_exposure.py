"""The light of photos is read from what they share, and only where it explains their difference."""

from dataclasses import replace

import pytest
import torch

from edit3r.contract.interfaces import Geometry
from edit3r.contract.types import Views
from edit3r.kit.geometry.exposure import (
    ExposureOfEdit,
    estimate_exposure,
    exposure_of_edit,
)
from edit3r_testing import photograph

SCENE = photograph(3, (96, 128))
GAINS = torch.tensor([[1.0, 1.0, 1.0], [0.7, 0.65, 0.75], [0.8, 0.9, 0.85]])
OFFSETS = torch.tensor([[0.0, 0.0, 0.0], [0.05, 0.04, 0.05], [0.1, 0.02, 0.0]])


def _geometry(registered: tuple[bool, ...] = (True, True, True)) -> Geometry:
    return Geometry(
        SCENE.cameras.c2w,
        SCENE.depths,
        torch.ones_like(SCENE.depths),
        torch.tensor([registered]),
    )


def _relit() -> Views:
    """The photos as others would expose and balance them."""
    gain, offset = GAINS[None, ..., None, None], OFFSETS[None, ..., None, None]
    images = (SCENE.views.images * gain + offset).clamp(0, 1)
    return replace(SCENE.views, images=images)


def test_photos_of_other_light_become_those_of_the_first():
    exposure = estimate_exposure(_relit(), _geometry())
    found = exposure.to_reference(_relit().images)
    assert (found - SCENE.views.images).abs().mean() < 0.01
    assert (_relit().images - SCENE.views.images).abs().mean() > 0.05
    assert torch.equal(found[:, 0], _relit().images[:, 0])


def test_its_own_light_is_given_back_to_every_photo():
    relit = _relit().images
    exposure = estimate_exposure(_relit(), _geometry())
    again = exposure.to_own(exposure.gain * relit + exposure.offset)
    assert torch.allclose(again, relit, atol=1e-6)


def test_a_photo_of_less_contrast_alone_becomes_as_the_first():
    images = SCENE.views.images.clone()
    mean = images[:, 1].mean((2, 3), keepdim=True)
    images[:, 1] = mean + 0.6 * (images[:, 1] - mean)
    exposure = estimate_exposure(replace(SCENE.views, images=images), _geometry())
    found = exposure.to_reference(images)
    assert (found - SCENE.views.images)[:, 1].abs().mean() < 0.01


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_photos_of_one_light_stay_as_they_are(noise):
    generator = torch.Generator().manual_seed(0)
    images = SCENE.views.images
    images = images + noise * torch.randn(images.shape, generator=generator)
    views = replace(SCENE.views, images=images.clamp(0, 1))
    assert estimate_exposure(views, _geometry()) is None


def test_photos_of_other_things_keep_their_light():
    generator = torch.Generator().manual_seed(1)
    other = 0.3 * torch.rand(SCENE.views.images.shape, generator=generator)
    other[:, 0] = SCENE.views.images[:, 0]
    assert estimate_exposure(replace(SCENE.views, images=other), _geometry()) is None


def test_a_photo_that_was_not_placed_keeps_its_light():
    exposure = estimate_exposure(_relit(), _geometry((True, True, False)))
    assert bool((exposure.gain[:, 2] == 1).all()) and bool(
        (exposure.gain[:, 1] != 1).all()
    )


def test_a_photo_that_shares_nothing_with_the_first_is_settled_through_another():
    """The third is linked with the second only."""
    views, geometry = _relit(), _geometry()
    apart = geometry.depths.clone()
    height = apart.shape[-2]
    apart[:, 0, : height // 2] = 0  # the first shows the lower half only
    apart[:, 2, height // 2 :] = 0  # the third the upper half only
    confidence = (apart > 0).to(apart)
    known = replace(geometry, depths=apart.clamp(min=1e-3), confidence=confidence)
    exposure = estimate_exposure(views, known)
    found = exposure.to_reference(views.images)
    assert (found[:, 2] - SCENE.views.images[:, 2]).abs().mean() < 0.03
    assert (views.images[:, 2] - SCENE.views.images[:, 2]).abs().mean() > 0.04


def test_photos_that_share_something_but_nothing_with_the_first_keep_their_light():
    geometry = _geometry()
    geometry.confidence[:, 0] = 0
    assert estimate_exposure(_relit(), geometry) is None


def test_surfaces_that_the_other_photo_only_guesses_tell_nothing_of_its_light():
    """Darker by itself, as in a shadow, where the second photo did not measure."""
    images = SCENE.views.images.clone()
    images[:, 1, :, :, 40:] *= 0.6
    views = replace(SCENE.views, images=images).select([0, 1])
    geometry = _geometry()
    known = Geometry(
        *(part[:, :2] for part in (geometry.c2w, geometry.depths, geometry.confidence)),
        geometry.registered[:, :2],
    )
    assert estimate_exposure(views, known) is not None
    known.confidence[:, 1, :, 36:] = 0
    assert estimate_exposure(views, known) is None


def test_each_scene_of_a_batch_has_its_own_light():
    both = replace(
        SCENE.views,
        images=torch.cat((SCENE.views.images, _relit().images)),
        intrinsics=SCENE.views.intrinsics.expand(2, -1, -1, -1),
    )
    geometry = _geometry()
    twice = {
        name: torch.cat((value, value))
        for name in ("c2w", "depths", "confidence", "registered")
        if (value := getattr(geometry, name)) is not None
    }
    exposure = estimate_exposure(both, Geometry(**twice))
    assert bool((exposure.gain[0] == 1).all()) and bool(
        (exposure.gain[1, 1:] != 1).all()
    )


def test_clipped_pixels_tell_nothing_of_the_light():
    """A photo exposed so long that a third of it is white has the gain of the rest."""
    images = SCENE.views.images.clone()
    images[:, 1] = (1.6 * images[:, 1]).clamp(0, 1)
    views = replace(SCENE.views, images=images)
    assert float((images[:, 1] > 0.97).float().mean()) > 0.1
    exposure = estimate_exposure(views, _geometry())
    assert torch.allclose(exposure.gain[0, 1], torch.tensor(1 / 1.6), atol=0.02)


EVERYWHERE = torch.ones_like(SCENE.depths, dtype=torch.bool)


def _exposure_of(images, region=EVERYWHERE):
    photos = estimate_exposure(_relit(), _geometry())
    edited = replace(SCENE.views, images=images)
    return photos, exposure_of_edit(photos, edited, region, _geometry())


def test_black_and_white_follows_the_light_of_photos_without_its_tint():
    grey = _relit().images.mean(2, keepdim=True).expand(-1, -1, 3, -1, -1)
    photos, exposure = _exposure_of(grey)
    found = exposure.to_reference(grey)
    assert torch.allclose(found[:, :, 0], found[:, :, 2])
    assert (found - grey[:, :1].mean()).abs().mean() < (
        grey - grey[:, :1].mean()
    ).abs().mean()
    tinted = photos.to_reference(grey)
    assert (tinted[:, 1, 0] - tinted[:, 1, 2]).abs().mean() > 0.02
    again = exposure.to_own(exposure.edit.gain * grey + exposure.edit.offset)
    assert torch.allclose(again, grey, atol=1e-6)


def test_what_is_drawn_alike_on_every_photo_stays_as_it_is():
    """White stays white, though in another light it would be cut off at white as well."""
    drawing = (SCENE.views.images.mean(2, keepdim=True) > 0.5).float()
    drawing = drawing.expand(-1, -1, 3, -1, -1)
    _, exposure = _exposure_of(drawing)
    assert torch.equal(exposure.to_reference(drawing), drawing)
    assert torch.equal(exposure.to_own(drawing), drawing)


def test_an_edit_in_the_colours_of_its_photo_follows_its_light():
    photos, exposure = _exposure_of(0.9 * _relit().images)
    assert exposure is photos


def test_light_of_an_edit_counts_only_where_it_was_made():
    region = EVERYWHERE.clone()
    region[..., 48:, :] = False
    images = _relit().images.clone()
    images[..., :48, :] = SCENE.views.images[..., :48, :]
    photos, exposure = _exposure_of(images, region)
    found, relit = exposure.to_reference(images), photos.to_reference(images)
    assert torch.equal(found[..., :48, :], images[..., :48, :])
    assert torch.equal(found[..., 48:, :], relit[..., 48:, :])
    small = torch.nn.functional.interpolate(images[0], scale_factor=0.5)[None]
    found = exposure.to_reference(small)  # of another size
    assert torch.equal(found[..., :24, :], small[..., :24, :])
    assert (found[:, 1:, :, 24:] - small[:, 1:, :, 24:]).abs().mean() > 0.05


def test_an_edit_of_what_no_two_photos_share_follows_the_photos():
    region = EVERYWHERE.clone()
    region[:, 1:] = False
    photos, exposure = _exposure_of(SCENE.views.images, region)
    assert exposure is photos and not isinstance(exposure, ExposureOfEdit)
