"""The four methods as reconstructors: their contract, what they ask of the editor, and a run from
end to end.
"""

import itertools

import pytest
import torch
from edit3r_optimisers.method import VISIBLE_OPACITY, EditJob, begin, thinned
from pydantic import ValidationError

import edit3r
from edit3r.contract.errors import SettingsError
from edit3r.contract.interfaces import StartsFromImages
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import EditRequest, Reconstruction
from edit3r_testing import ReconstructorContract

METHODS = ("refit", "instruct-nerf2nerf", "gaussctrl", "editsplat")
ASK = EditRequest("invert", seed=2)


@pytest.fixture(params=METHODS)
def method(request) -> str:
    return request.param


OWN = (
    "test_gaussians_are_valid_and_finite",
    "test_batch_items_are_independent",
    "test_same_photos_give_the_same_result",
)
"""Claims that each method is held to; the rest is kept, or not, by what the methods share."""
SHARED = (
    "test_source_photos_are_accepted",
    "test_geometry_of_its_own_is_valid",
    "test_predicted_cameras_are_poses_of_the_views",
    "test_declared_limits_are_true",
    "test_leaves_its_inputs_alone",
    "test_photos_without_texture_end_in_a_result_or_a_sentence",
    "test_checkpoint_round_trip",
    "test_a_step_of_training_reaches_the_network",
    "test_trained_weights_load_by_the_setting_weights",
)


@pytest.mark.parametrize(
    "method, claim",
    [*itertools.product(METHODS, OWN), *itertools.product(("refit",), SHARED)],
    indirect=["method"],
)
def test_contract_holds(method, claim, build):
    class Quick(ReconstructorContract):
        component = method
        image_size = (24, 32)

        def build(self):
            return build(method, steps=2, edit_steps=2)

    getattr(Quick(), claim)()


def test_every_claim_of_the_contract_is_tried():
    own = {name for name in vars(ReconstructorContract) if name.startswith("test_")}
    assert own == {*OWN, *SHARED}


def test_the_scene_takes_the_edited_colours(method, build, posed, rasterizer):
    """The editor inverts; a scene fitted to its edits is nearer to the inverted photos than to the
    photos.
    """
    inverted = edit3r.Views(1 - posed.images, posed.intrinsics)
    fast = {"steps": 12, "edit_steps": 36, "colour_rate": 0.15}
    if method == "instruct-nerf2nerf":
        fast |= {"edit_every": 2, "least_strength": 0.9}
    result = build(method, **fast).edit_and_reconstruct(inverted, posed, ASK)
    seen = rasterizer.render(result.gaussians, result.cameras).images
    to_edits, to_photos = (
        (seen - views.images).abs().mean() for views in (inverted, posed)
    )
    assert to_edits < 0.5 * to_photos


@pytest.mark.parametrize(
    "name, settings, calls",
    [
        ("refit", {}, 0),
        ("instruct-nerf2nerf", {"edit_every": 2, "edit_steps": 7}, 4),
        ("instruct-nerf2nerf", {"edit_every": 7, "edit_steps": 7}, 1),
        ("gaussctrl", {}, 1),
        ("editsplat", {}, 3),
    ],
)
def test_the_editor_is_called_as_often_as_the_method_says(
    build, editor, posed, name, settings, calls
):
    inverted = edit3r.Views(1 - posed.images, posed.intrinsics)
    build(name, **settings).edit_and_reconstruct(inverted, posed, ASK)
    assert len(editor.calls) == calls
    assert all(request.prompt == "invert" for _, request in editor.calls)


def test_editsplat_edits_itself_when_it_is_given_nothing_edited(build, editor, posed):
    build("editsplat").edit_and_reconstruct(posed, posed, ASK)
    assert [views.count for views, _ in editor.calls] == [3, 1, 1, 1]


def test_editsplat_edits_each_view_again_from_its_neighbours_edits_too(
    build, editor, posed
):
    """View 0 is edited to black, the others to white: what view 0 begins from is neither."""
    starts = []

    class Starting(type(editor), StartsFromImages):
        def edit_from(self, views, start, request, strength):
            starts.append(start)
            return edit3r.Views(start, views.intrinsics)

    edits = torch.ones_like(posed.images)
    edits[:, 0] = 0
    views = edit3r.Views(edits, posed.intrinsics)
    method = build("editsplat", {"editor": Starting()})
    method.edit_and_reconstruct(views, posed, ASK)
    assert [start.shape[1] for start in starts] == [1, 1, 1]
    assert 0.3 < starts[0].mean() < 1 and starts[1].min() < 0.7


def test_refit_of_nothing_edited_is_the_first_fit_alone(build, posed):
    report = Report()
    with collecting(report):
        build("refit")(posed, posed)
    assert "refit.photos" in report.notes and "refit.edits" not in report.notes


def test_prompt_and_seed_of_the_settings_count_when_no_run_gives_others(
    build, editor, posed
):
    build("gaussctrl", prompt="paint it", seed=4)(posed)
    assert (editor.calls[0][1].prompt, editor.calls[0][1].seed) == ("paint it", 4)


@pytest.mark.parametrize("name", ["recolor", "mock-diffusion"])
def test_a_run_gives_the_method_its_editor_prompt_and_masks(build, posed, name):
    recon = build("instruct-nerf2nerf", {"editor": edit3r.build("editor", name)})
    masks = torch.zeros(1, 3, 32, 40)
    masks[..., :20] = 1
    parts = {"editor": recon.editor, "recon": recon}
    result = edit3r.run(posed, "make it red", **parts, masks=masks, seed=1)
    assert result.report.notes["refit.edits_of_the_dataset"] == 1
    assert result.gaussians.count > 0 and result.cameras.count == 3


def test_in_a_run_by_names_the_editor_is_the_runs_own(posed):
    recon = {"name": "refit", "steps": 1, "edit_steps": 1, "points": 50}
    result = edit3r.run(posed, "make it red", recon=recon, editor="none")
    assert result.reconstructor.editor is result.editor
    assert result.editor.offer.component.name == "none"


def test_strengths_in_the_wrong_order_are_refused():
    wrong = {"least_strength": 0.9, "most_strength": 0.2}
    with pytest.raises((SettingsError, ValidationError), match="least_strength"):
        edit3r.build("reconstructor", "instruct-nerf2nerf", **wrong)


@pytest.fixture
def first(build, posed) -> Reconstruction:
    return build("refit").reconstructor(posed)


def test_a_fit_begins_with_visible_gaussians_and_the_cameras_of_the_reconstruction(
    build, posed, first
):
    scene = EditJob(posed, posed, EditRequest(""), geometry=None)
    gaussians, cameras = begin(scene, build("refit").reconstructor, 100, seed=0)
    assert torch.equal(cameras.c2w, first.cameras.c2w)
    assert gaussians.count == 100 and gaussians.opacities.min() >= VISIBLE_OPACITY


def test_thinned_gaussians_cover_as_much_as_before(first):
    few = thinned(first.gaussians, 100, seed=0)
    ratio = first.gaussians.count / 100
    assert few.count == 100 and thinned(first.gaussians, 10**6, 0) is first.gaussians
    widened = few.scales[0, :, 0] / first.gaussians.scales[0, :, 0].mean()
    assert float(widened.mean()) == pytest.approx(ratio**0.5, rel=0.1)
