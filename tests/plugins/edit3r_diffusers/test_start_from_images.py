"""Edits begun from a picture instead of noise, and the optimisation methods that use them, on tiny
random models.
"""

from dataclasses import replace

import pytest
import torch
from edit3r_diffusers.attention import WordAttention
from edit3r_diffusers.latents import skipping, steps_left

import edit3r
from edit3r.contract.interfaces import Matcher
from edit3r.contract.reporting import Report, collecting
from edit3r_testing.scenes import photograph

pytestmark = pytest.mark.slow

ASK = edit3r.EditRequest("paint it red", seed=3)
STEPS = 6


@pytest.fixture(scope="module")
def editor(tiny):
    settings = {"steps": STEPS, "resolution": 0, "local_files_only": True}
    return edit3r.build(
        "editor", "instruct-pix2pix", model=str(tiny.instruct_pix2pix()), **settings
    )


@pytest.fixture
def one_view(two_views):
    return two_views.select([0])


@pytest.fixture(scope="module")
def posed():
    truth = photograph(3, (32, 32))
    return replace(truth.views, c2w=truth.cameras.c2w).select([0, 2])


def steps_shown(call) -> int:
    """Denoising steps of the first view, as the progress bar shows them."""
    shown = []
    report = Report(on_event=lambda event, *told: shown.append(told))
    with collecting(report):
        call()
    return next(total for text, _, total in shown if text.startswith("editing"))


def test_strength_is_a_share_of_the_steps():
    assert [steps_left(20, strength) for strength in (0, 0.5, 1)] == [1, 10, 20]


@pytest.mark.slow
def test_only_the_steps_that_are_left_are_taken(editor, one_view):
    call = lambda: editor.edit_from(one_view, 1 - one_view.images, ASK, 0.5)  # noqa: E731
    assert steps_shown(call) == 3
    assert steps_shown(lambda: editor.edit(one_view, ASK)) == STEPS


def test_less_strength_keeps_more_of_the_picture_it_starts_from(editor, one_view):
    """By how much another start changes the result: all of it survives one step, little survives
    all of them.
    """

    def difference(strength):
        starts = [torch.full_like(one_view.images, level) for level in (0.2, 0.8)]
        dark, light = (
            editor.edit_from(one_view, start, ASK, strength).images for start in starts
        )
        return float((dark - light).abs().mean())

    assert difference(0.15) > 2 * difference(1.0)


@pytest.mark.slow
def test_the_photos_stay_the_condition(editor, one_view):
    start = torch.full_like(one_view.images, 0.5)
    other = replace(one_view, images=one_view.images.flip(-1))
    first, second = (
        editor.edit_from(views, start, ASK, 0.5).images for views in (one_view, other)
    )
    assert not torch.equal(first, second)


@pytest.mark.slow
def test_a_whole_edit_afterwards_is_what_it_was_before(editor, one_view):
    before = editor.edit(one_view, ASK).images
    begun = editor.edit_from(one_view, one_view.images, ASK, 0.2).images
    assert torch.equal(editor.edit(one_view, ASK).images, before)
    again = editor.edit_from(one_view, one_view.images, ASK, 0.2).images
    assert torch.equal(again, begun)


@pytest.mark.parametrize(
    "name",
    ["DDIMScheduler", "EulerAncestralDiscreteScheduler", "EulerDiscreteScheduler"],
)
def test_skipped_steps_are_the_first_whatever_the_sampler(name):
    import diffusers

    scheduler = getattr(diffusers, name)()
    scheduler.set_timesteps(8)
    whole = scheduler.timesteps.clone()
    sample = torch.randn(1, 4, 4, 4, generator=torch.Generator().manual_seed(0))
    with skipping(scheduler, 5):
        scheduler.set_timesteps(8)
        assert torch.equal(scheduler.timesteps, whole[5:])
        for timestep in scheduler.timesteps:
            scaled = scheduler.scale_model_input(sample, timestep)
            sample = scheduler.step(torch.zeros_like(sample), timestep, scaled)[0]
    assert torch.isfinite(sample).all()
    scheduler.set_timesteps(8)
    assert torch.equal(scheduler.timesteps, whole)


@pytest.mark.slow
def test_attention_is_a_map_of_every_view_that_hangs_on_the_words(editor, two_views):
    before = editor.edit(two_views, ASK).images
    maps = editor.attention(two_views, ASK)
    assert maps.shape == (1, 2, *two_views.image_size)
    assert maps.min() >= 0 and maps.max() <= 1 and maps.std() > 0
    other = editor.attention(two_views, replace(ASK, prompt="make it snow"))
    assert not torch.equal(maps, other)
    # nothing of the listening stays
    assert torch.equal(editor.edit(two_views, ASK).images, before)


def test_attention_is_read_without_guidance_too(tiny, two_views):
    settings = {"steps": 1, "resolution": 0, "local_files_only": True, "guidance": 1}
    unguided = edit3r.build(
        "editor", "instruct-pix2pix", model=str(tiny.instruct_pix2pix()), **settings
    )
    maps = unguided.attention(two_views.select([0]), ASK)
    assert torch.isfinite(maps).all() and maps.std() > 0


def test_listening_changes_no_attention_and_adds_the_shares_of_the_words():
    """Against diffusers' own processor, and a sum over the words by hand."""
    from diffusers.models.attention_processor import Attention

    torch.manual_seed(0)
    layer = Attention(query_dim=8, cross_attention_dim=6, heads=2, dim_head=4)
    places, words = torch.randn(3, 12, 8), torch.randn(3, 5, 6)
    expected = layer(places, words)
    listener = WordAttention(words=2, halves=3)
    layer.set_processor(listener)
    assert torch.allclose(layer(places, words), expected, atol=1e-5)
    query, key = (
        t[0].view(-1, 2, 4).transpose(0, 1)
        for t in (layer.to_q(places), layer.to_k(words))
    )
    # 2: root of the heads' width
    shares = (query @ key.transpose(-1, -2) / 2).softmax(-1)
    by_hand = shares[..., 1] + shares[..., 2]
    assert torch.allclose(listener.maps[12], by_hand.mean(0), atol=1e-5)
    picture = listener.image((6, 8))
    assert picture.shape == (6, 8) and picture.max() <= 1


TINY = {"steps": 3, "edit_steps": 4, "points": 60}


@pytest.mark.slow
@pytest.mark.parametrize("method", ["instruct-nerf2nerf", "editsplat"])
def test_optimisation_methods_run_with_instruct_pix2pix(editor, posed, method):
    report = Report()
    settings = TINY | ({"edit_every": 2} if method == "instruct-nerf2nerf" else {})
    with collecting(report):
        recon = edit3r.build("reconstructor", method, {"editor": editor}, **settings)
        geometry = edit3r.build("matcher", "posed").match(posed)
        result = recon.edit_and_reconstruct(posed, posed, ASK, geometry)
    assert result.gaussians.count > 0
    assert not any("cannot start from a given" in text for text in report.warnings)
    if method == "editsplat":
        told_by = report.notes["editsplat.trimmed"]["attention_told_by"]
        assert told_by == "the editor's cross-attention"


@pytest.mark.slow
def test_gaussctrl_gives_controlnet_depth_the_fitted_geometry_and_its_own_reference_views(
    tiny, posed
):
    class Refusing(Matcher):
        def match(self, views):
            raise AssertionError("the fitted depth was to be used")

    settings = {"references": 1, "steps": 2, "resolution": 0, "local_files_only": True}
    models = {"model": tiny.stable_diffusion(), "controlnet": tiny.controlnet()}
    settings |= {name: str(folder) for name, folder in models.items()}
    parts = {"matcher": Refusing()}
    editor = edit3r.build("editor", "controlnet-depth", parts, **settings)
    report = Report()
    with collecting(report):
        parts = {"editor": editor}
        recon = edit3r.build("reconstructor", "gaussctrl", parts, **TINY, together=2)
        geometry = edit3r.build("matcher", "posed").match(posed)
        result = recon.edit_and_reconstruct(posed, posed, ASK, geometry)
    assert result.gaussians.count > 0
    assert not [text for text in report.warnings if text.startswith("gaussctrl")]
    told = report.notes["gaussctrl.editor"]
    assert told["aligns_views"] and told["depth_of_the_fit"]
