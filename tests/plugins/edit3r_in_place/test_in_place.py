"""The edit goes into the scene's own Gaussians, and nowhere else."""

from dataclasses import replace

import pytest
import torch
from edit3r_in_place.colours import bounded, shine_of

import edit3r
from edit3r.contract.errors import InputError, PromptError
from edit3r.contract.types import EditRequest, Gaussians, Views
from edit3r.kit import asking
from edit3r.kit.rendering import OverBackground
from edit3r.kit.scenes.scene_views import look_around, pictures_of
from edit3r_testing import ReconstructorContract
from tests.plugins.scan import of_ball, scan

SIZE = (56, 72)
BLUE = torch.tensor([0.1, 0.2, 0.9]).view(3, 1, 1)


@pytest.fixture(scope="module")
def rasterizer():
    return edit3r.build("rasterizer", "numba")


def seen(gaussians, rasterizer, count=6):
    places = look_around(gaussians, rasterizer, count=count, size=SIZE)
    return pictures_of(gaussians, places, rasterizer).scene


def in_place(scene, **settings):
    return edit3r.build("reconstructor", "in-place", **settings).starting_from(scene)


def pixels_of(scene, ball):
    """Where the red ball (0) is seen, or the green one (1)."""
    own = scene.images[0, :, ball]
    others = [scene.images[0, :, other] for other in range(3) if other != ball]
    return ((own > 1.8 * others[0]) & (own > 1.8 * others[1])).float()


def red_pixels(scene):
    return pixels_of(scene, 0)


def painted(scene, masks):
    images = scene.images[0] + masks[:, None] * (BLUE - scene.images[0])
    return Views(images[None], scene.cameras.intrinsics)


@pytest.mark.parametrize(
    "claim",
    [
        "test_gaussians_are_valid_and_finite",
        "test_geometry_of_its_own_is_valid",
        "test_source_photos_are_accepted",
        "test_predicted_cameras_are_poses_of_the_views",
        "test_same_photos_give_the_same_result",
        "test_leaves_its_inputs_alone",
    ],
)
def test_started_from_a_scene_it_keeps_the_contract(claim, rasterizer):
    scene = seen(scan(1), rasterizer, count=2)

    class OfScene(ReconstructorContract):
        component = "in-place"
        image_size = SIZE

        def build(self):
            return in_place(scene)

        def _views(self, count=None, batch=1):
            return painted(scene, red_pixels(scene))

    getattr(OfScene(), claim)()


@pytest.mark.parametrize("degree", [0, 2])
def test_a_painted_thing_has_the_paint_and_all_else_looks_as_it_did(rasterizer, degree):
    scene = seen(scan(degree), rasterizer)
    views = painted(scene, red_pixels(scene))
    made = in_place(scene)(views)
    asking.reconstruct(in_place(scene), views, lambda: made)
    shown = OverBackground(rasterizer, scene.background)
    ball = made.gaussians.harmonics[0, of_ball(made.gaussians, 0), 0]
    blue = (BLUE.flatten() - 0.5) / 0.28209479
    assert (ball.median(0).values - blue).abs().max() < 0.35
    again = shown.render(made.gaussians, scene.cameras).images[0]
    before = shown.render(scene.gaussians, scene.cameras).images[0]
    error = ((again - views.images[0]) ** 2).mean()
    assert error < 0.05 * ((before - views.images[0]) ** 2).mean()


def test_all_but_the_harmonics_of_the_painted_have_the_bits_they_had(rasterizer):
    scene = seen(scan(1), rasterizer)
    made = in_place(scene)(painted(scene, red_pixels(scene))).gaussians
    for name in ("means", "scales", "quats", "opacities"):
        assert torch.equal(getattr(made, name), getattr(scene.gaussians, name))
    changed = (made.harmonics != scene.gaussians.harmonics).flatten(2).any(2)[0]
    assert changed[of_ball(made, 0)].float().mean() > 0.9
    assert not changed[of_ball(made, 1)].any()
    assert changed[600:].float().mean() < 0.1  # of the floor, what the ball hides


def test_pictures_without_an_edit_change_nothing(rasterizer):
    scene = seen(scan(1), rasterizer, count=2)
    made = in_place(scene)(Views(scene.images, scene.cameras.intrinsics))
    assert made.gaussians is scene.gaussians
    assert bool(made.kept.all())


def removal(masks):
    return asked("remove the ball", masks)


def asked(text, masks, regions=None):
    """The request of a sentence; `regions` are those of its instructions."""
    instructions = edit3r.build("reader", "grammar").read(text)
    regions = None if regions is None else regions[:, None]
    return EditRequest(text, 0, masks[None], instructions, regions)


def test_a_removed_thing_is_taken_out_and_the_rest_keeps_its_bits(rasterizer):
    scene = seen(scan(), rasterizer)
    views = Views(scene.images, scene.cameras.intrinsics)
    recon = in_place(scene, fill=False)
    made = recon.edit_and_reconstruct(views, views, removal(red_pixels(scene)))
    assert not made.kept[of_ball(scene.gaussians, 0)].float().mean() > 0.1
    assert made.kept[of_ball(scene.gaussians, 1)].all()
    assert torch.equal(made.gaussians.means, scene.gaussians.means[:, made.kept])


def test_a_mask_that_covers_what_is_empty_too_removes_the_thing(rasterizer):
    scene = seen(scan(), rasterizer)
    views = Views(scene.images, scene.cameras.intrinsics)
    wide = torch.maximum(red_pixels(scene), (scene.alphas[0] < 0.02).float())
    recon = in_place(scene, fill=False)
    made = recon.edit_and_reconstruct(views, views, removal(wide))
    gone, stays = (of_ball(scene.gaussians, one) for one in (0, 1))
    assert made.kept[gone].float().mean() < 0.1 < 0.9 < made.kept[stays].float().mean()


def test_a_removal_that_nothing_places_is_refused(rasterizer):
    scene = seen(scan(), rasterizer, count=2)
    views = Views(scene.images, scene.cameras.intrinsics)
    with pytest.raises(PromptError, match="what is to be removed"):
        in_place(scene).edit_and_reconstruct(
            views, views, replace(removal(red_pixels(scene)), masks=None)
        )
    with pytest.raises(InputError, match="none of the scene"):
        in_place(scene).edit_and_reconstruct(
            views, views, removal(torch.zeros_like(scene.alphas[0]))
        )


def test_nearly_all_of_a_scene_is_not_removed(rasterizer):
    fly = scan().select(torch.arange(20))
    means = 0.2 * fly.means - torch.tensor([0.0, 1.5, 0.0])
    fly = replace(fly, means=means, scales=0.5 * fly.scales)
    scene = seen(Gaussians.cat([scan(), fly]), rasterizer, count=1)
    views = Views(scene.images, scene.cameras.intrinsics)
    masks = scene.alphas[0].clone()
    empty = (masks[0].amax(1) < 0.1).nonzero()[:, 0]
    top = int((masks[0].amax(1) >= 0.1).nonzero()[0])
    masks[:, : int(empty[empty > top][0])] = 0  # all but the fly
    with pytest.raises(InputError, match=r"all of the scene.*--candidate 2"):
        in_place(scene).edit_and_reconstruct(views, views, removal(masks))


def test_one_thing_is_painted_and_another_removed_by_one_sentence(rasterizer):
    scene = seen(scan(), rasterizer)
    balls = torch.stack([pixels_of(scene, ball) for ball in (0, 1)])
    views = painted(scene, balls.amax(0))  # as if a 2D removal had made it blue
    request = asked("paint the apple blue and remove the pear", balls[0], balls)
    made = in_place(scene, fill=False).edit_and_reconstruct(views, views, request)
    apple, pear = (of_ball(scene.gaussians, one) for one in (0, 1))
    assert made.kept[pear].float().mean() < 0.1
    assert made.kept[apple].all()
    colour = made.gaussians.harmonics[0, :300, 0] * 0.28209479 + 0.5
    assert colour.mean(0)[2] > 2 * colour.mean(0)[0]
    floor = made.gaussians.harmonics[0, 300:]
    assert (floor == scene.gaussians.harmonics[0, made.kept][300:]).float().mean() > 0.9


def test_its_geometry_is_the_scenes_whatever_the_pictures_show(rasterizer):
    scene = seen(scan(), rasterizer, count=3)
    views = Views(torch.rand_like(scene.images), scene.cameras.intrinsics)
    geometry = asking.find_geometry(in_place(scene), views)
    solid = scene.alphas > 0.5
    assert torch.equal(geometry.depths[solid], scene.depths[solid])
    assert torch.equal(geometry.confidence, solid.float())


def test_without_a_scene_it_says_what_to_give(rasterizer):
    recon = edit3r.build("reconstructor", "in-place")
    views = Views(torch.rand(1, 2, 3, 8, 8), torch.eye(3).expand(1, 2, 3, 3))
    with pytest.raises(InputError, match="splat file in place of photos"):
        recon(views)
    other = in_place(seen(scan(), rasterizer, count=2))
    with pytest.raises(InputError, match="given scene's"):
        other(views)


def test_beside_what_is_removed_nothing_takes_the_colours_of_the_picture_without_it(
    rasterizer,
):
    """A soft outline reaches over the floor, where a 2D removal changed the picture too."""
    scene = seen(scan(), rasterizer)
    pear = pixels_of(scene, 1)
    rim = torch.nn.functional.max_pool2d(pear[:, None], 9, 1, 4)[:, 0]
    apple = red_pixels(scene) * (rim == 0)
    outlines = torch.stack([apple, torch.maximum(pear, 0.2 * rim)])
    views = painted(scene, torch.maximum(apple, rim))
    request = asked("paint the apple blue and remove the pear", outlines[0], outlines)
    made = in_place(scene, fill=False).edit_and_reconstruct(views, views, request)
    before = scene.gaussians.harmonics[0, made.kept]
    stays = of_ball(scene.gaussians, 0)[made.kept].logical_not()
    assert torch.equal(made.gaussians.harmonics[0, stays], before[stays])


def test_all_that_one_sentence_removes_is_taken_out(rasterizer):
    scene = seen(scan(), rasterizer)
    things = torch.stack([pixels_of(scene, ball) for ball in (0, 1)])
    views = Views(scene.images, scene.cameras.intrinsics)
    request = asked("remove the apple and remove the pear", things.amax(0), things)
    assert len(request.instructions) == 2
    made = in_place(scene, fill=False).edit_and_reconstruct(views, views, request)
    for ball in (0, 1):
        assert made.kept[of_ball(scene.gaussians, ball)].float().mean() < 0.1


def test_shine_is_fitted_by_its_own_colour_into_the_wanted_one(rasterizer):
    """Of red shine that becomes green, green is made of red, and not the other way round."""
    scene = seen(scan(1), rasterizer, count=4)
    given = scene.gaussians
    harmonics = given.harmonics.clone()
    harmonics[..., 1:, 1:] = 0  # all shine is red
    shining = replace(given, harmonics=harmonics)
    green = harmonics.clone()
    green[..., 1:, :] = harmonics[..., 1:, [1, 0, 2]]
    wanted = rasterizer.render(replace(given, harmonics=green), scene.cameras)
    inside = torch.ones(4, *SIZE, dtype=torch.bool)
    every = torch.ones(given.count, dtype=torch.bool)
    found = shine_of(
        shining, scene.cameras, wanted.images[0], inside, every, rasterizer
    )
    assert found[1, 0] > 0.7 and abs(found[0, 1]) < 0.1


@pytest.mark.slow
def test_a_colour_beyond_the_range_stays_there_and_goes_no_farther():
    before = torch.tensor([[-0.2, 0.5, 1.3]])
    assert torch.equal(bounded(before, 0 * before), 0 * before)
    far = bounded(before, torch.tensor([[-1.0, 1.0, 1.0]]))
    torch.testing.assert_close(before + far, torch.tensor([[-0.2, 1.0, 1.3]]))


def test_behind_what_one_sees_through_the_background_is_no_shine(rasterizer):
    """All becomes lighter, so that its shine, which shows from above, stays."""
    thin = scan(1)
    harmonics = thin.harmonics.clone()
    harmonics[..., 1:, :] = 0
    harmonics[..., 1, :] = 0.3
    thin = replace(thin, opacities=0.4 * thin.opacities, harmonics=harmonics)
    scene = seen(thin, rasterizer, count=4)
    images = scene.images + 0.1 * scene.alphas[:, :, None]
    made = in_place(scene)(Views(images, scene.cameras.intrinsics))
    shine = made.gaussians.harmonics[0, :, 1]
    torch.testing.assert_close(shine, harmonics[0, :, 1], atol=0.05, rtol=0)
