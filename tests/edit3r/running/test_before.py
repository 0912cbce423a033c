"""The look before the edit: what the page shows for it."""

from dataclasses import replace

import torch

from edit3r.contract.types import Cameras, Rendering, Views
from edit3r.running.before import colours_before
from edit3r_testing.scenes import balls


def test_colours_before_are_those_of_the_unedited_photos():
    """A wall of one Gaussian per pixel, and one hidden behind it in another colour."""
    torch.manual_seed(0)
    ys, xs = torch.meshgrid(
        torch.arange(30) + 0.5, torch.arange(40) + 0.5, indexing="ij"
    )
    rays = torch.stack(
        ((xs / 40 - 0.5) / 0.9, (ys / 30 - 0.5) / 1.2, torch.ones(30, 40)), -1
    ).flatten(0, 1)
    means = torch.cat((2 * rays, 4 * rays[:1]))[None]
    count = means.shape[1]
    photos, edited = torch.rand(1, 1, 3, 30, 40), torch.rand(1, 1, 3, 30, 40)
    colours = torch.cat((edited[0, 0].flatten(1).T, 1 - edited[0, 0, :, :1, 0].T))[None]
    made = balls(means, colours)
    lens = torch.tensor([[0.9, 0, 0.5], [0, 1.2, 0.5], [0, 0, 1]])[None, None]
    one = Cameras(torch.eye(4)[None, None], lens, (300, 400))
    rendered = Rendering(
        edited, torch.ones(1, 1, 1, 30, 40), torch.full((1, 1, 1, 30, 40), 2.0)
    )
    views = [Views(images, one.intrinsics) for images in (photos, edited)]
    for view in (-1, 0):
        found = colours_before(
            replace(made, view_index=torch.full((count,), view)), one, *views, rendered
        )
        torch.testing.assert_close(
            found[:-1], photos[0, 0].flatten(1).T, atol=1e-4, rtol=0
        )
        torch.testing.assert_close(found[-1], colours[0, -1])


def before_of_one(photos, edited, grey):
    """Colour before an edit of one Gaussian of no view, that is grey now and seen by two photos."""
    lens = torch.tensor([[0.9, 0, 0.5], [0, 1.2, 0.5], [0, 0, 1]]).expand(1, 2, 3, 3)
    cameras = Cameras(torch.eye(4).repeat(1, 2, 1, 1), lens, (30, 40))
    scene = balls(torch.tensor([[[0.0, 0, 2]]]), grey)
    depths = torch.full((1, 2, 1, 30, 40), 2.0)
    rendered = Rendering(edited, torch.ones_like(depths), depths)
    views = [Views(images, lens) for images in (photos, edited)]
    return colours_before(scene, cameras, *views, rendered)


def test_what_two_photos_show_gets_its_colour_back_from_the_first_alone():
    """A Gaussian of no view, of the edit's colour on both photos."""
    edited = torch.full((1, 2, 3, 30, 40), 0.5)
    found = before_of_one(edited + 0.05, edited, 0.5)
    torch.testing.assert_close(found, torch.full((1, 3), 0.55))


def test_a_rim_of_both_colours_takes_that_of_the_photo_and_what_is_hidden_none():
    """Left half of the photo is edited; rims lie on it, beside it, and behind what it shows."""
    lens = torch.tensor([[0.9, 0, 0.5], [0, 1.2, 0.5], [0, 0, 1]]).expand(1, 1, 3, 3)
    cameras = Cameras(torch.eye(4)[None, None], lens, (30, 40))
    photos = torch.full((1, 1, 3, 30, 40), 0.2)
    edited = photos.clone()
    edited[..., :20] = 1.0
    depths = torch.full((1, 1, 1, 30, 40), 2.0)
    means = torch.tensor([[[-0.8, 0.0, 2], [0.8, 0, 2], [-1.6, 0, 4]]])
    scene = balls(means, 0.6)
    rendered = Rendering(edited, torch.ones_like(depths), depths)
    views = [Views(images, lens) for images in (photos, edited)]
    found = colours_before(scene, cameras, *views, rendered)
    torch.testing.assert_close(found[:, 0], torch.tensor([0.2, 0.6, 0.6]))


def test_what_took_the_colour_of_a_photo_is_left_alone_by_the_photos_after_it():
    """A rim on the first photo, whose colour then is like the edit on the second."""
    photos = torch.full((1, 2, 3, 30, 40), 0.2)
    edited = torch.full_like(photos, 1.0)
    photos[:, 1], edited[:, 1] = 0.9, 0.2
    found = before_of_one(photos, edited, 0.6)
    torch.testing.assert_close(found, torch.full((1, 3), 0.2))
