"""The pipeline's promises, with small editors and reconstructors made here."""

import json
import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from edit3r.api import run
from edit3r.contract.errors import InputError, PluginError, SettingsError
from edit3r.contract.interfaces import (
    ChangesShape,
    ComparesWithBefore,
    Editor,
    EditsViews,
    FindsGeometry,
    Geometry,
    Reconstructor,
)
from edit3r.contract.reporting import Report
from edit3r.contract.types import Cameras, Reconstruction, Views
from edit3r.kit.geometry.cameras import pixels_to_gaussians
from edit3r.kit.geometry.harmonics import dc_to_colour
from edit3r.kit.geometry.maps import composite
from edit3r.kit.rendering import render_each
from edit3r.loading.registry import build
from edit3r.running.config import DEFAULTS, make_run_config
from edit3r.running.job import JobInputs, job_from
from edit3r.running.pipeline import preview
from edit3r.running.result import _scene
from edit3r.running.steps.reconstruct import _grid
from edit3r_testing import photograph

PLAIN = {"gaussians": "all", "refine": 0}  # the reconstructor's own Gaussians


class Invert(Editor):
    def edit(self, views, request):
        return Views(1 - views.images, views.intrinsics, views.names)


class Answer(Editor):
    """Returns whatever it is told to."""

    def __init__(self, answer):
        self.answer = answer

    def edit(self, views, request):
        return self.answer(views)


class Flat(Reconstructor):
    """One Gaussian per pixel on the plane z = 1 with the picture's colours."""

    max_views = 3

    def __init__(self, spoil=None):
        self.spoil = spoil

    def __call__(self, views, source=None, geometry=None, grid=None):
        ones = torch.ones_like(views.images[:, :, 0])
        pose = torch.eye(4).expand(1, views.count, 4, 4)
        cameras = Cameras(pose, views.intrinsics, views.image_size)
        made = pixels_to_gaussians(views.images, ones, cameras, 0.01 * ones, ones)
        if self.spoil:
            getattr(made, self.spoil)[0, 0] = float("nan")
        return Reconstruction(made, cameras)


@pytest.fixture
def views():
    images = torch.rand(1, 2, 3, 6, 8, generator=torch.Generator().manual_seed(0))
    intrinsics = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]]).expand(
        1, 2, 3, 3
    )
    return Views(images, intrinsics, ("a", "b"))


def test_pixels_outside_the_masks_are_bit_equal_whatever_the_editor_does(views):
    masks = torch.zeros(1, 2, 6, 8)
    masks[:, :, :3, :4] = 1
    result = run(views, "x", editor=Invert(), recon=Flat(), masks=masks)
    inside = masks[:, :, None].expand_as(views.images) == 1
    assert torch.equal(result.edited.images[~inside], views.images[~inside])
    assert torch.equal(result.edited.images[inside], (1 - views.images)[inside])
    assert result.report.notes["edit.change_outside_mask_before_composite"] > 0.1


def test_what_an_editor_has_to_change_around_the_things_may_change_too(views):
    class Shadows(Invert):
        def widened(self, regions, images):
            wide = regions.clone()
            wide[..., :5] = 1
            return wide

    masks = torch.zeros(1, 2, 6, 8)
    masks[..., :3] = 1
    result = run(views, "paint it red", editor=Shadows(), recon=Flat(), masks=masks)
    assert result.masks[0, 0, 0].tolist() == [1, 1, 1, 1, 1, 0, 0, 0]
    changed = (result.edited.images != views.images).any(2)
    assert bool(changed[..., :5].all()) and not changed[..., 5:].any()


def test_composite_blends_between_and_is_exact_at_zero_and_one():
    original, edited = (
        torch.full((1, 1, 3, 1, 3), 0.1),
        torch.full((1, 1, 3, 1, 3), 0.7),
    )
    blended = composite(original, edited, torch.tensor([[[[0.0, 0.5, 1.0]]]]))
    assert blended[0, 0, 0, 0].tolist() == pytest.approx([0.1, 0.4, 0.7])
    assert (
        blended[0, 0, 0, 0, 0] == original[0, 0, 0, 0, 0]
        and blended[0, 0, 0, 0, 2] == edited[0, 0, 0, 0, 2]
    )


def test_edit_views_first_leaves_the_other_views_as_they_were(views):
    result = run(views, "x", editor=Invert(), recon=Flat(), edit_views="first")
    assert torch.equal(result.edited.images[:, 0], 1 - views.images[:, 0])
    assert torch.equal(result.edited.images[:, 1], views.images[:, 1])


def test_too_few_views_is_an_error_that_names_both_counts(views):
    with pytest.raises(InputError, match="at least 2 photos of the same scene, got 1"):
        run(views.select([0]), "x", editor=Invert(), recon=Flat())


def test_too_many_views_are_subsampled_evenly_with_a_warning(views):
    report = Report()
    result = run(
        views.select([0, 1, 0, 1, 0]), "x", editor=Invert(), recon=Flat(), report=report
    )
    assert result.photos.count == 3
    assert any("of 5 these are used: [0, 2, 4]" in text for text in report.warnings)


def test_a_preview_shows_the_views_that_a_run_would_take(views):
    job = job_from(JobInputs(), {"prompt": "x"})
    many, masks = views.select([0, 1, 0, 1, 0]), torch.zeros(1, 5, 6, 8)
    masks[:, [0, 2, 4]] = 1
    components = {"editor": Invert(), "reconstructor": Flat()}
    job = replace(job, photos=many, masks=masks, components=components)
    for edits in (True, False):
        seen = preview(job, report=Report(), edits=edits)
        assert seen.inputs.photos.count == 3
        assert seen.selection.masks.shape[1] == 3 and bool(seen.selection.masks.all())


def test_an_editor_or_a_reconstruction_that_breaks_its_contract_is_named(views):
    with pytest.raises(PluginError, match="return images of shape"):
        small = Answer(lambda v: Views(v.images[..., :4], v.intrinsics))
        run(views, "x", editor=small, recon=Flat())
    with pytest.raises(PluginError, match="means with"):
        run(views, "x", editor=Invert(), recon=Flat(spoil="means"))


def test_masks_of_the_wrong_size_are_an_error_with_both_sizes(views):
    with pytest.raises(InputError, match=r"\[1, 2, 6, 8\], got \[1, 2, 3, 3\]"):
        run(views, "x", editor=Invert(), recon=Flat(), masks=torch.ones(1, 2, 3, 3))


def test_an_edit_that_does_nothing_is_reported(views):
    report = Report()
    run(views, "x", editor=Answer(lambda v: v), recon=Flat(), report=report)
    assert any(
        "(100%) of what was selected did not change" in text for text in report.warnings
    )


def test_the_edit_is_judged_before_and_after_the_3d_part(views):
    job = job_from(JobInputs(), {"prompt": "paint it red"})
    job = replace(job, photos=views, components={"editor": Answer(lambda v: v)})
    report = Report()
    seen = preview(job, report=report)
    assert seen.edit.verdict.label == "doubtful"
    assert seen.edit.verdict.measures["missed"] is None
    assert any(
        "the edit is doubtful: a part (100%)" in text for text in report.warnings
    )
    result = run(views, "invert it", editor=Invert(), recon=Flat())
    assert result.edit_verdict.measures["unchanged"] < 0.1
    assert result.edit_verdict.measures["missed"] is not None


def test_without_a_prompt_there_is_no_edit_to_judge(views):
    assert run(views, editor="none", recon=Flat()).edit_verdict is None


def test_the_three_answers_stand_in_the_manifest(views, tmp_path):
    masks = torch.ones(1, 2, *views.image_size)
    masks[..., :4] = 0
    asked = {"masks": masks, "outputs": ["sheet"]}
    result = run(views, "x", editor=Invert(), recon=Flat(), **asked)
    content = json.loads((result.save(tmp_path / "out") / "run.json").read_text())
    assert content["verdict"]["label"] == result.verdict.label
    assert content["edit_verdict"]["reason"] == result.edit_verdict.reason
    assert set(content["edit_verdict"]["measures"]) >= {"unchanged", "rim", "missed"}
    assert content["selection_verdict"]["label"] == "given"
    assert result.selection_verdict.confidence is None


def test_a_reconstructor_that_edits_is_given_the_request(views):
    class Editing(Flat, EditsViews):
        def edit_and_reconstruct(self, views, source, request, geometry=None):
            self.request = request
            return self(views)

    editing, masks = Editing(), torch.ones(1, 2, 6, 8)
    run(views, "warmer", editor=Invert(), recon=editing, masks=masks, seed=7)
    assert (editing.request.prompt, editing.request.seed) == ("warmer", 7)
    assert torch.equal(editing.request.masks, masks)


@pytest.mark.parametrize(("refine", "grid"), [(2, (3, 4)), (0, (6, 8))])
def test_gaussians_are_made_on_a_grid_only_where_steps_bring_the_detail(
    views, refine, grid
):
    class OnGrid(Flat):
        def __call__(self, views, source=None, geometry=None, grid=None):
            self.made = views.at(grid)
            return super().__call__(self.made)

    recon = OnGrid()
    result = run(
        views,
        editor=Answer(lambda v: v),
        recon=recon,
        grid=0.5,
        refine=refine,
        gaussians="all",
    )
    assert recon.made.image_size == grid
    assert result.cameras.image_size == (6, 8) and result.rendered.images.shape[
        -2:
    ] == (6, 8)


def test_the_edit_is_judged_at_the_size_of_the_photos_whatever_the_grid(views):
    critic, asked = build("critic", "limits"), []
    judge = critic.judge_edit
    critic.judge_edit = lambda edit: asked.append(edit) or judge(edit)
    steps = {"grid": 0.5, "refine": 1, "gaussians": "all"}

    class OnGrid(Flat):
        def __call__(self, views, source=None, geometry=None, grid=None):
            return super().__call__(views.at(grid))

    run(views, "x", editor=Invert(), recon=OnGrid(), critic=critic, **steps)
    first, second = asked
    assert first.cameras is first.rendered is None
    assert second.cameras.image_size == second.rendered.images.shape[-2:] == (6, 8)


@pytest.mark.parametrize(
    ("count", "refine", "grid"),
    [(20, 8, (48, 64)), (80, 8, (24, 32)), (80, 0, (96, 128))],
)
def test_more_than_twenty_views_share_the_pixels_of_twenty(count, refine, grid):
    many = Views(torch.zeros(1, count, 3, 96, 128), torch.eye(3).expand(1, count, 3, 3))
    parts = SimpleNamespace(
        config=SimpleNamespace(refine=refine, grid=0.5),
        reconstructor=SimpleNamespace(fuses_by_itself=False),
    )
    assert _grid(parts, many) == grid


class Counting(Flat):
    """Counts how often it is asked."""

    calls = 0

    def __call__(self, views, source=None, geometry=None, grid=None):
        self.calls += 1
        return super().__call__(views, source)


class CountingAndEditing(Counting, EditsViews):
    def edit_and_reconstruct(self, views, source, request, geometry=None):
        return self(views, source)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("recon", "mask", "asked"),
    [
        (Counting, None, 1),
        (Counting, 0.0, 2),
        (Counting, 1.0, 1),
        (CountingAndEditing, 0.0, 1),
    ],
    ids=["no masks", "masks", "masks of everything", "a reconstructor that edits"],
)
def test_the_scene_before_the_edit_is_made_only_where_a_mask_keeps_something(
    views, recon, mask, asked
):
    masks = None if mask is None else torch.full((1, 2, 6, 8), mask)
    if masks is not None:
        masks[..., :3, :] = 1
    counting = recon()
    run(views, "x", editor=Invert(), recon=counting, masks=masks, rasterizer="torch")
    assert counting.calls == asked


def test_where_things_come_or_go_nothing_is_held_to_the_scene_before(views):
    class Reshapes(Invert, ChangesShape):
        pass

    masks = torch.zeros(1, 2, 6, 8)
    masks[..., :4] = 1
    for editor, asked in ((Invert(), 2), (Reshapes(), 1)):
        counting = Counting()
        result = run(views, "x", editor=editor, recon=counting, masks=masks)
        assert counting.calls == asked
        assert (result.records.reconstructed.before is None) == (asked == 1)


class LeavingOut(Flat):
    """Could not place view 1 of three."""

    def __call__(self, views, source=None, geometry=None, grid=None):
        placed = torch.tensor([[True, False, True]])
        return replace(
            super().__call__(views),
            placed=placed,
            measured=torch.tensor([[1.0, 0.0, 0.5]]),
        )


def test_a_view_that_was_not_placed_leaves_the_scene_and_is_told(views):
    three = Views(
        torch.rand(1, 3, 3, 6, 8), views.intrinsics[:, [0, 0, 0]], ("a", "b", "c")
    )
    masks = torch.ones(1, 3, 6, 8)
    result = run(
        three,
        "x",
        editor=Invert(),
        recon=LeavingOut(),
        masks=masks,
        rasterizer="torch",
        **PLAIN,
    )
    assert result.photos.names == result.edited.names == (
        "a",
        "c",
    ) and result.records.reconstructed.left_out.names == ("b",)
    assert result.cameras.count == 2 and result.masks.shape[1] == 2
    assert (
        result.gaussians.view_index.unique().tolist() == [0, 1]
        and result.gaussians.count == 2 * 6 * 8
    )
    colours = dc_to_colour(result.gaussians.from_view(1).harmonics[0, :, 0])
    assert torch.allclose(colours, (1 - three.images[0, 2]).flatten(1).T, atol=1e-6)
    assert (
        result.verdict.placed == (True, False, True)
        and result.verdict.input_psnr[1] is None
    )
    assert result.verdict.filled == (0.0, None, 0.5)


class OnItsSide(Flat):
    """Finds that the last view was turned by a quarter, clockwise."""

    def __call__(self, views, source=None, geometry=None, grid=None):
        found = super().__call__(views, source)
        c2w = found.cameras.c2w.clone()
        clockwise = torch.tensor([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
        c2w[:, -1, :3, :3] = c2w[:, -1, :3, :3] @ clockwise
        return replace(found, cameras=replace(found.cameras, c2w=c2w))


def test_a_photo_that_is_not_held_as_the_others_is_named_with_the_way_to_turn_it(views):
    three = Views(
        torch.rand(1, 3, 3, 6, 8), views.intrinsics[:, [0, 0, 0]], ("a", "b", "c")
    )
    result = run(
        three, "x", editor=Invert(), recon=OnItsSide(), rasterizer="torch", **PLAIN
    )
    told = [text for text in result.report.warnings if "turned on its side" in text]
    assert len(told) == 1
    assert told[0].startswith("c: ") and "to the left" in told[0]


class Fused(Flat):
    """Says that fusing the edits made the second view lighter."""

    def __call__(self, views, source=None, geometry=None, grid=None):
        fusion = torch.zeros(1, views.count, 3, 4, 5)
        fusion[:, 1] = 0.25
        return replace(super().__call__(views, source), fusion=fusion)


def test_refiners_follow_the_fused_edits_and_the_verdict_the_2d_edits(
    views, monkeypatch
):
    followed = []
    monkeypatch.setattr(
        "edit3r.kit.asking.refine",
        lambda refiner, gaussians, inputs: followed.append(inputs.views) or gaussians,
    )
    steps = {"gaussians": "all", "refine": 1}
    result = run(views, editor=Invert(), recon=Fused(), **steps)
    assert torch.equal(followed[0].images[:, 0], 1 - views.images[:, 0])
    assert torch.allclose(
        followed[0].images[:, 1], (1.25 - views.images[:, 1]).clamp(max=1), atol=1e-6
    )
    assert torch.equal(result.edited.images, 1 - views.images)


def test_the_fused_edit_does_not_count_outside_the_masks(views, monkeypatch):
    followed = []
    monkeypatch.setattr(
        "edit3r.kit.asking.refine",
        lambda refiner, gaussians, inputs: followed.append(inputs.views) or gaussians,
    )
    masks = torch.zeros(1, views.count, *views.image_size)
    masks[..., :4] = 1
    result = run(views, editor=Invert(), recon=Fused(), masks=masks, **PLAIN)
    assert torch.equal(followed[0].images[..., 4:], result.edited.images[..., 4:])
    assert not torch.equal(
        followed[0].images[:, 1, ..., :4], result.edited.images[:, 1, ..., :4]
    )


def test_only_what_compares_with_the_scene_before_gets_it_in_a_first_run(
    views, monkeypatch
):
    given = []

    def refined(refiner, gaussians, inputs):
        given.append((isinstance(refiner, ComparesWithBefore), inputs.before))
        return gaussians

    monkeypatch.setattr("edit3r.kit.asking.refine", refined)
    masks = torch.zeros(1, views.count, *views.image_size)
    masks[..., :4] = 1
    steps = {"gaussians": "all", "refine": 1}
    run(views, editor=Invert(), recon=Flat(), masks=masks, **steps)
    assert [compares for compares, _ in given] == [True, False]
    assert given[0][1] is not None and given[1][1] is None


def test_refiners_are_applied_in_the_order_of_the_list_with_the_shorthands_first(views):
    config = make_run_config(
        {"refiners": ["refine", "keep-outside-mask"], "gaussians": 5, "refine": 3}
    )
    listed = [(choice.name, choice.settings) for choice in config.all_refiners()]
    fewer = (
        "simplify",
        {"gaussians": 5, **DEFAULTS["shorthands"]["gaussians_before_refine"]},
    )
    assert listed == [fewer, ("refine", {"steps": 3}), ("keep-outside-mask", {})]
    both = {"refiners": ["keep-outside-mask"], "gaussians": 5, "refine": 3}
    names = [choice.name for choice in make_run_config(both).all_refiners()]
    assert names == ["simplify", "refine", "keep-outside-mask"]


def test_stages_are_timed_in_order(views):
    result = run(views, "x", editor=Invert(), recon=Flat(), **PLAIN)
    names = [stage.name for stage in result.report.stages]
    assert names == [
        "read photos",
        "load components",
        "look up words",
        "select",
        "edit (Invert)",
        "reconstruct (Flat)",
        "check",
    ]
    assert all(stage.seconds >= 0 for stage in result.report.stages)


@pytest.mark.parametrize("device", ["cuda:99", "foo", "mps", "", "meta2"])
def test_a_device_that_torch_cannot_use_is_one_sentence(views, device):
    with pytest.raises(
        SettingsError,
        match=f"--device: '{device}' cannot be used on this machine .* use --device cpu",
    ):
        run(views, "x", editor=Invert(), recon=Flat(), device=device)


def test_an_editor_that_leaves_the_program_is_named(views):
    with pytest.raises(
        PluginError, match=r"editor 'Answer' ended the program \(sys.exit\(0\)\)"
    ):
        run(views, "x", editor=Answer(lambda v: sys.exit(0)), recon=Flat())


class FindsTruth(Flat, FindsGeometry):
    """Keeps the views that it was given, and knows the true geometry."""

    def __init__(self, scene):
        super().__init__()
        self.scene = scene
        self.given = []

    def find_geometry(self, views):
        depths = self.scene.depths
        placed = torch.ones(depths.shape[:2], dtype=torch.bool)
        sure = torch.ones_like(depths)
        return Geometry(self.scene.cameras.c2w, depths, sure, placed)

    def __call__(self, views, source=None, geometry=None, grid=None):
        self.given.append((views, source))
        return super().__call__(views)


def test_the_scene_is_made_in_the_light_of_the_first_photo_and_shown_in_each_ones_own(
    monkeypatch,
):
    scene = photograph(2, (48, 64))
    images = scene.views.images.clone()
    images[:, 1] = 0.6 * images[:, 1] + 0.03
    views = replace(scene.views, images=images)
    results = {}
    for light in ("one", "own"):
        recon = FindsTruth(scene)
        result = run(views, editor="none", recon=recon, exposure=light, **PLAIN)
        results[light] = (recon.given[0], result)
    (edited, source), one = results["one"]
    for given in (edited, source):
        assert (given.images - scene.views.images).abs().mean() < 0.01
    (edited, _), own = results["own"]
    assert torch.equal(edited.images, images)
    assert torch.equal(one.edited.images, images) and torch.equal(
        one.photos.images, images
    )
    drawn = render_each(one.rasterizer, one.gaussians, one.cameras, "again").images
    assert torch.equal(
        one.rendered.images, one.records.corrected.exposure.to_own(drawn)
    )
    assert own.records.located.exposure is None
    # The look before the edit is the scene's, which is in one light.
    monkeypatch.setattr("edit3r.running.result.colours_before", lambda *given: given)
    for given in _scene(one).second_look().colours[2:4]:
        assert (given.images - scene.views.images).abs().mean() < 0.01


class Greys(Editor):
    """Black and white by the mean of the channels."""

    def edit(self, views, request):
        grey = views.images.mean(2, keepdim=True).expand_as(views.images)
        return replace(views, images=grey.contiguous())


class GreysElsewhere(Greys, ChangesShape):
    pass


def test_a_black_and_white_scene_has_no_tint_of_the_photos_light():
    scene = photograph(2, (48, 64))
    images, tint = scene.views.images.clone(), torch.tensor([0.6, 0.8, 0.9])
    images[:, 1] = tint.view(3, 1, 1) * images[:, 1]
    views = replace(scene.views, images=images)
    recon = FindsTruth(scene)
    result = run(views, "x", editor=Greys(), recon=recon, **PLAIN)
    edited, source = recon.given[0]
    assert torch.allclose(edited.images[:, :, 0], edited.images[:, :, 2])
    assert (
        edited.images - scene.views.images.mean(2, keepdim=True)
    ).abs().mean() < 0.03
    assert (source.images - scene.views.images).abs().mean() < 0.01
    drawn = render_each(result.rasterizer, result.gaussians, result.cameras, "again")
    exposure = result.records.corrected.exposure
    assert torch.equal(result.rendered.images, exposure.to_own(drawn.images))
    masks = torch.zeros_like(images[:, :, 0])
    masks[..., 32:] = 1
    run(views, "x", editor=Greys(), recon=recon, masks=masks, **PLAIN)
    edited, _ = recon.given[1]
    assert torch.allclose(edited.images[..., 0, :, 32:], edited.images[..., 2, :, 32:])
    outside = (edited.images - scene.views.images)[..., :32]
    assert outside.abs().mean() < 0.01
    # What stands elsewhere afterwards cannot be compared, so the photos' light counts.
    result = run(views, "x", editor=GreysElsewhere(), recon=recon, **PLAIN)
    edited, _ = recon.given[-1]
    exposure = result.records.located.exposure
    assert torch.equal(result.records.corrected.exposure.gain, exposure.gain)
    assert torch.equal(edited.images, exposure.to_reference(result.edited.images))


def test_a_photo_keeps_its_light_where_one_before_it_could_not_be_placed():
    class WithoutTheSecond(FindsTruth):
        def __call__(self, views, source=None, geometry=None, grid=None):
            made = super().__call__(views, source)
            return replace(made, placed=torch.tensor([[True, False, True]]))

    scene = photograph(3, (48, 64))
    images = scene.views.images.clone()
    images[:, 2] = 0.6 * images[:, 2] + 0.03
    views = replace(scene.views, images=images)
    result = run(views, editor="none", recon=WithoutTheSecond(scene), **PLAIN)
    exposure = result.records.corrected.exposure
    assert exposure.gain.shape[1] == result.photos.count == 2
    assert float((exposure.gain[:, 1] - 1).abs().min()) > 0.3
    drawn = render_each(result.rasterizer, result.gaussians, result.cameras, "again")
    assert torch.equal(result.rendered.images, exposure.to_own(drawn.images))


def test_geometry_of_the_unedited_photos_is_found_once_and_before_the_edit():
    scene = photograph(2, (48, 64))
    asked = []

    class Listening(FindsTruth):
        def find_geometry(self, views):
            asked.append(views.images)
            return super().find_geometry(views)

    result = run(scene.views, "x", editor=Invert(), recon=Listening(scene), **PLAIN)
    assert len(asked) == 1 and torch.equal(asked[0], scene.views.images)
    names = [stage.name for stage in result.report.stages]
    assert (
        names.index("geometry") < names.index("select") < names.index("edit (Invert)")
    )


def test_only_the_red_parts_of_a_given_mask_are_changed(views):
    images = torch.full((1, 2, 3, 6, 8), 0.1)
    images[..., :4] = torch.tensor([0.8, 0.1, 0.1])[:, None, None]
    masks = torch.zeros(1, 2, 6, 8)
    masks[..., :3, :] = 1
    given = replace(views, images=images)
    result = run(
        given,
        "paint only the red parts blue",
        editor="recolor",
        recon=Flat(),
        masks=masks,
    )
    changed = (result.edited.images != images).any(2)
    assert bool(changed[..., :3, :4].all())
    assert not changed[..., 3:, :].any() and not changed[..., 4:].any()


def test_editing_again_the_first_view_alone_holds_back_nothing_in_the_others(views):
    first = run(views, "x", editor=Invert(), recon=Flat(), **PLAIN)

    def some(given):
        images = given.images.clone()
        images[..., :3, :] = 1 - images[..., :3, :]
        return replace(given, images=images)

    for asked, others in (("first", 1.0), ("all", 0.5)):
        again = run(
            prompt="y",
            earlier=first,
            editor=Answer(some),
            recon=Flat(),
            edit_views=asked,
            **PLAIN,
        )
        masks = again.masks[0]
        assert float(masks[0].mean()) == 0.5
        assert float(masks[1].mean()) == others


def test_views_without_names_are_saved_and_names_lead_nowhere_else(tmp_path):
    views = photograph(2, (32, 48)).views
    for names, files in (((), ("view 0", "view 1")), (("../a", "b"), ("__a", "b"))):
        named = replace(views, names=names)
        result = run(
            named, editor="none", recon=Flat(), outputs=["images", "scene"], **PLAIN
        )
        assert result.photos.names == files
        saved = result.save(tmp_path / files[0])
        assert {file.stem for file in (saved / "inputs").iterdir()} == {*files}
