"""Every way in which an edit goes wrong is named by its signal, and a good edit by none."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from edit3r_judge.critic import LimitsCritic
from edit3r_judge.signals import (
    SIGNALS,
    faults_of,
    fitted_limits,
    measured,
    unlike_either,
)

from edit3r.contract.instructions import Change, Colour, Instruction, Target
from edit3r.contract.interfaces import EditToJudge, HalfWay
from edit3r.contract.types import Cameras, Rendering, Views

ROOT = Path(__file__).parents[3]
SIZE, SIDE = 96, 40
RED = (0.8, 0.1, 0.1)
PAINT_RED = Instruction(
    "paint", Target("marked"), (Change("paint", Colour("red", RED)),)
)
REMOVE = Instruction("remove", Target("marked"))
GREYSCALE = Instruction("paint", Target("marked"), (Change("greyscale"),))
DEPTH = 2.0
SHIFT = 16  # pixels that the thing lies further left in the second photo
LEFTS = (40, 40 - SHIFT)


def square(left: int, inner: int = 0) -> torch.Tensor:
    mask = torch.zeros(SIZE, SIZE)
    mask[28 + inner : 68 - inner, left + inner : left + SIDE - inner] = 1
    return mask


def views(images: torch.Tensor) -> Views:
    return Views(images[None], torch.eye(3).expand(1, len(images), 3, 3))


def over(images: torch.Tensor, colour, masks: torch.Tensor) -> torch.Tensor:
    """Images with a colour where masks say so."""
    paint = torch.tensor(colour)[:, None, None]
    return torch.where(masks[:, None] > 0, paint, images)


def judged(edit: EditToJudge, **changes) -> EditToJudge:
    """The edit with other pictures, which its scene shows too."""
    edit = replace(edit, **changes)
    return replace(edit, rendered=replace(edit.rendered, images=edit.after.images))


@pytest.fixture
def good() -> EditToJudge:
    """A striped green square on grey in two photos of a wall, painted red, in 3D too."""
    masks = torch.stack([square(left) for left in LEFTS])
    stripes = (torch.arange(SIZE) // 4 % 2)[:, None].expand(SIZE, SIZE)
    photos = over(torch.full((2, 3, SIZE, SIZE), 0.4), (0.2, 0.6, 0.3), masks)
    photos = photos - 0.15 * (masks * stripes)[:, None]
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1, 0, 3] = SHIFT / SIZE * DEPTH
    k = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]]).expand(1, 2, 3, 3)
    depths = torch.full((1, 2, 1, SIZE, SIZE), DEPTH)
    after = views(over(photos, RED, masks))
    return EditToJudge(
        before=views(photos),
        after=after,
        edited=range(2),
        instructions=(PAINT_RED,),
        selected=(),
        masks=masks[None],
        regions=masks[None, None],
        rendered=Rendering(after.images, torch.ones_like(depths), depths),
        cameras=Cameras(c2w, k, (SIZE, SIZE)),
    )


def test_where_nothing_could_be_told_and_where_nothing_changed_that_is_said(good):
    critic = LimitsCritic(None)
    flat = replace(good, rendered=None, cameras=None)

    def said(masks, after=good.after):
        verdict = critic.judge_edit(
            replace(flat, masks=masks, regions=masks[None], after=after)
        )
        assert verdict.label == "doubtful"
        return verdict.reason

    black = torch.zeros_like(good.masks)
    assert "nothing is selected" in said(black, good.before)
    tiny = black.clone()
    tiny[..., 50:53, 50:53] = 1
    assert said(tiny, good.before) == "nothing changed"
    red = views(over(good.before.images[0], RED, tiny[0]))
    assert "too small to tell" in said(tiny, red)


def test_dark_parts_of_what_is_painted_in_metal_need_not_be_as_saturated(good):
    """Light and shade of a metal stay: half of it is dark gold."""
    gold = (0.83, 0.69, 0.22)
    paint = Instruction(
        "paint", Target("marked"), (Change("paint", Colour("gold", gold)),)
    )
    light = torch.ones(SIZE, SIZE)
    light[:52] = 0.15
    old = over(torch.full((2, 3, SIZE, SIZE), 0.4), (0.5, 0.5, 0.5), good.masks[0])
    old = torch.where(good.masks[0][:, None] > 0, old * light, old)
    shaded = over(old, gold, good.masks[0])
    new = torch.where(good.masks[0][:, None] > 0, shaded * light, shaded)
    edit = judged(
        replace(good, before=views(old), instructions=(paint,)), after=views(new)
    )
    assert measured(edit)["as_asked"] > 0.9
    faintly = judged(edit, after=views(old + 0.25 * (new - old)))
    assert measured(faintly)["as_asked"] < fitted_limits("edit")["as_asked"]


def half_done(edit):
    images = edit.after.images.clone()
    images[..., :48, :] = edit.before.images[..., :48, :]
    return judged(edit, after=views(images[0]))


def leaked(edit):
    wide = torch.stack([square(left) for left in (10, 60)])
    return judged(edit, after=views(over(edit.after.images[0], RED, wide)))


def elsewhere(edit):
    masks = torch.stack([square(LEFTS[0]), square(52)])
    after = views(over(edit.before.images[0], RED, masks))
    return judged(edit, after=after, masks=masks[None], regions=masks[None, None])


def another_colour(edit):
    blue = over(edit.before.images[0], (0.1, 0.2, 0.8), edit.masks[0])
    return judged(edit, after=views(blue))


def faint(edit):
    before, after = edit.before.images, edit.after.images
    return judged(edit, after=views((before + 0.25 * (after - before))[0]))


def with_rim(edit):
    inner = torch.stack([square(left, 3) for left in LEFTS])
    return judged(edit, after=views(over(edit.before.images[0], RED, inner)))


def ghost(edit):
    half = 0.5 * edit.before.images + 0.5 * gone(edit).after.images
    return judged(edit, after=views(half[0]), instructions=(REMOVE,))


def gone(edit):
    after = views(torch.full_like(edit.before.images[0], 0.4))
    return judged(edit, after=after, instructions=(REMOVE,))


def smeared(edit):
    """A large thing before a wall with a pattern, closed without any."""
    noise = torch.rand(2, 3, SIZE, SIZE, generator=torch.Generator().manual_seed(0))
    masks = torch.zeros(2, SIZE, SIZE)
    masks[:, 6:90, 6:90] = 1
    after = views(over(noise, (0.5, 0.5, 0.5), masks))
    given = {"masks": masks[None], "regions": masks[None, None]}
    return judged(
        edit, before=views(noise), after=after, instructions=(REMOVE,), **given
    )


def guessed(edit):
    """A large thing before a colourful wall, in whose place stands more of such a wall."""
    random = torch.Generator().manual_seed(0)
    blocks = torch.rand(2, 2, 3, 12, 12, generator=random).repeat_interleave(8, 3)
    wall, other = blocks.repeat_interleave(8, 4)
    masks = torch.zeros(2, SIZE, SIZE)
    masks[:, 16:80, 16:80] = 1
    after = views(torch.where(masks[:, None] > 0, other, wall))
    given = {"masks": masks[None], "regions": masks[None, None]}
    return judged(
        edit, before=views(wall), after=after, instructions=(REMOVE,), **given
    )


def grey(edit):
    mean = edit.before.images.mean(2, keepdim=True).expand_as(edit.before.images)
    return judged(edit, after=views(mean[0]), instructions=(GREYSCALE,))


def half_grey(edit):
    """Black and white, of a thing that has next to no colour to lose."""
    pale = 0.4 + 0.12 * (edit.before.images - 0.4)
    mean = pale.mean(2, keepdim=True).expand_as(pale)
    half = torch.where(torch.arange(SIZE)[:, None] < 48, mean, pale)
    before, after = views(pale[0]), views(half[0])
    return judged(edit, before=before, after=after, instructions=(GREYSCALE,))


def half_in_3d(edit):
    images = edit.after.images.clone()
    images[:, 1, :, :48] = edit.before.images[:, 1, :, :48]
    return replace(edit, rendered=replace(edit.rendered, images=images))


def from_half_way(edit, images, shift=SHIFT):
    """The edit with what its scene shows from half-way between the photos."""
    pose = edit.cameras.c2w[:, :1].clone()
    pose[0, 0, 0, 3] = shift / SIZE * DEPTH / 2
    cameras = Cameras(pose, edit.cameras.intrinsics[:, :1], (SIZE, SIZE))
    depths = torch.full((1, 1, 1, SIZE, SIZE), DEPTH)
    shown = Rendering(images[None], torch.ones_like(depths), depths)
    return replace(edit, half_way=HalfWay(shown, cameras, ((0, 1),)))


def whole_half_way(edit):
    mask = square(LEFTS[0] - SHIFT // 2)[None]
    return from_half_way(edit, over(torch.full((1, 3, SIZE, SIZE), 0.4), RED, mask))


def torn_half_way(edit):
    """Both photos show it as it should be; between them a third of it is a gap."""
    images = whole_half_way(edit).half_way.rendered.images[0].clone()
    images[..., 42:55, :] = 0.4
    return from_half_way(edit, images)


def test_what_moves_far_is_found_half_way(good):
    """Of a pair whose photos share half of what they show, flow alone finds little."""
    random = torch.Generator().manual_seed(3)
    wall = torch.rand(1, 3, SIZE // 4, SIZE, generator=random)
    wall = wall.repeat_interleave(4, 2).repeat_interleave(4, 3)  # four photos wide
    far = SIZE // 2
    photos = torch.cat([wall[..., left : left + SIZE] for left in (60, 60 + far)])
    masks = torch.stack([square(48), torch.roll(square(48), -far, 1)])
    masks[1, :, far:] = 0
    between = wall[..., 60 + far // 2 : 60 + far // 2 + SIZE]
    c2w = good.cameras.c2w.clone()
    c2w[0, 1, 0, 3] = far / SIZE * DEPTH
    edit = replace(
        good,
        before=views(photos),
        after=views(photos),
        masks=masks[None],
        regions=masks[None, None],
        cameras=replace(good.cameras, c2w=c2w),
    )
    edit = from_half_way(edit, between, far)
    assert measured(edit)["torn"] < fitted_limits("edit")["torn"] / 2
    undirected = replace(edit, cameras=None)
    assert measured(undirected)["torn"] > fitted_limits("edit")["torn"]


def test_half_way_is_compared_in_the_light_that_the_scene_has(good):
    """The scene is half as bright as the photos; told so, nothing is torn."""
    edit = whole_half_way(good)
    rendered = edit.half_way.rendered
    dark = replace(rendered, images=rendered.images / 2)
    as_taken = replace(edit.half_way, rendered=dark)
    photos = replace(edit.after, images=edit.after.images / 2)
    in_its_light = replace(as_taken, photos=photos)
    told, untold = (
        measured(replace(edit, half_way=one))["torn"]
        for one in (in_its_light, as_taken)
    )
    assert told < 0.05 < 0.3 < untold


def test_half_way_is_compared_at_the_size_of_the_photos():
    """384 x 203 pixels: as critics are given them 256 x 135; half of each is 192 x 102 and 101."""
    photos = {view: torch.rand(3, 102, 192) for view in (0, 1)}
    masks = {view: torch.ones(102, 192) > 0 for view in (0, 1)}
    shown = Rendering(torch.rand(1, 1, 3, 135, 256), torch.ones(1, 1, 1, 135, 256))
    eye = Cameras(torch.eye(4)[None, None], torch.eye(3)[None, None], (135, 256))
    ((pair, _),) = unlike_either(
        HalfWay(shown, eye, ((0, 1),)), photos, masks, 12, 1, side=192
    )
    assert pair == (0, 1)


FAULTS = {
    "unchanged": half_done,
    "outside": leaked,
    "shared": elsewhere,
    "as_asked": another_colour,
    "rim": with_rim,
    "closed": ghost,
    "invented": guessed,
    "missed": half_in_3d,
    "torn": torn_half_way,
}


def test_there_is_a_made_fault_and_a_limit_for_each_signal():
    """A signal that is taken away, or has no limit, leaves a fault unnamed."""
    assert list(FAULTS) == list(SIGNALS) == list(fitted_limits("edit"))


@pytest.mark.parametrize(
    ("name", "spoilt"),
    [
        *FAULTS.items(),
        ("as_asked", faint),
        ("unchanged", half_grey),
        ("closed", smeared),
    ],
)
def test_a_made_fault_is_named(good, name, spoilt):
    bad = spoilt(good)
    named = faults_of(measured(bad), fitted_limits("edit"))
    assert name in named
    verdict = LimitsCritic(None).judge_edit(bad)
    assert verdict.label == "doubtful" and named[name] in verdict.reason
    json.dumps(verdict.measures, allow_nan=False)


def test_what_another_photo_shows_is_not_invented(good):
    bad = guessed(good)
    alone = bad.masks.clone()
    alone[:, 1] = 0
    seen = replace(bad, masks=alone, regions=alone[None])
    assert measured(seen)["invented"] is None
    # a photo that looks elsewhere shows nothing of it
    away = seen.cameras.c2w.clone()
    away[0, 1, 0, 3] = 100
    elsewhere = replace(seen, cameras=replace(seen.cameras, c2w=away))
    assert measured(elsewhere)["invented"] > fitted_limits("edit")["invented"]
    before_any_scene = replace(bad, rendered=None, cameras=None)
    assert measured(before_any_scene)["invented"] is None


def test_what_tears_half_way_is_named_though_the_photos_show_it(good):
    bad = measured(torn_half_way(good))
    assert bad["missed"] == 0
    assert list(faults_of(bad, fitted_limits("edit"))) == ["torn"]
    aside = over(torch.full((1, 3, SIZE, SIZE), 0.4), RED, square(LEFTS[0] - 3)[None])
    assert (
        measured(from_half_way(good, aside))["torn"] < fitted_limits("edit")["torn"] / 2
    )
    whole = replace(torn_half_way(good), masks=None, regions=None)
    # of a whole picture it is the scene's matter
    assert measured(whole)["torn"] is None


@pytest.mark.parametrize(
    "well", [lambda edit: edit, gone, grey, whole_half_way], ids=range(4)
)
def test_what_was_carried_out_well_is_good(good, well):
    edit = well(good)
    assert faults_of(measured(edit), fitted_limits("edit")) == {}
    verdict = LimitsCritic(None).judge_edit(edit)
    assert verdict.label == "good" and "in 3D too" in verdict.reason
    assert f"\nedit: {verdict}.\n" in (ROOT / "docs/verdict.md").read_text()
    flat = LimitsCritic(None).judge_edit(replace(edit, rendered=None, cameras=None))
    assert flat.label == "good" and "in 3D" not in flat.reason
    assert flat.measures["missed"] is None


def test_whoever_edits_by_a_model_may_leave_most_of_it(good):
    hat = replace(
        half_done(good), instructions=(Instruction("other", Target("marked")),)
    )
    verdict = LimitsCritic(None).judge_edit(hat)
    assert verdict.label == "good" and "as asked, no signal tells" in verdict.reason
    none = judged(hat, after=hat.before)
    assert "did not change" in LimitsCritic(None).judge_edit(none).reason


def test_what_has_another_colour_may_stay_and_what_looks_as_asked_need_not_change(good):
    before = good.before.images[0].clone()
    tyre = torch.stack([square(left, 12) for left in LEFTS])
    kept = over(good.after.images[0], (0.02, 0.02, 0.02), tyre)
    before = over(before, (0.02, 0.02, 0.02), tyre)
    edit = judged(good, before=views(before), after=views(kept))
    assert measured(edit)["unchanged"] == 0
    red = views(over(good.before.images[0], (0.78, 0.12, 0.1), good.masks[0]))
    assert measured(judged(good, before=red, after=red))["unchanged"] is None
    # light and shade on a grey thing are no colour
    shade = torch.linspace(0.2, 0.8, SIZE).expand(2, 3, SIZE, SIZE)
    grey = Change("paint", Colour("grey", (0.5, 0.5, 0.5)))
    asked = (Instruction("paint", Target("marked"), (grey,)),)
    stone = judged(good, before=views(shade), after=views(shade), instructions=asked)
    assert measured(stone)["unchanged"] is None


def test_a_red_thing_in_the_shade_that_is_painted_red_came_all_the_way(good):
    dull, less = (
        over(good.before.images[0], RED, good.masks[0]) * s for s in (0.5, 0.6)
    )
    edit = judged(good, before=views(dull), after=views(less))
    assert measured(edit)["as_asked"] == 1
    blue = over(good.before.images[0], (0.1, 0.2, 0.8), good.masks[0])
    assert measured(judged(edit, after=views(blue)))["as_asked"] < 0


@pytest.mark.parametrize("amount", [-1.0, 1.0])
def test_light_comes_as_far_as_it_changed_the_way_that_was_asked(good, amount):
    change = (Change("brightness", amount=amount),)
    asked = (Instruction("paint", Target("marked"), change),)
    old, inside = good.before.images[0], good.masks[0][:, None] > 0
    for way, share in ((amount, 1), (-amount, 0)):
        new = torch.where(inside, old * (1 + 0.4 * way), old)
        edit = judged(good, after=views(new), instructions=asked)
        assert measured(edit)["as_asked"] == share


def test_what_nobody_sees_does_not_speak_against_black_and_white(good):
    pale = 0.4 + 0.15 * (good.before.images - 0.4)
    left = pale + 0.6 * (pale.mean(2, keepdim=True) - pale)
    edit = replace(good, before=views(pale[0]), instructions=(GREYSCALE,))
    assert measured(judged(edit, after=views(left[0])))["as_asked"] == 1


def test_faults_of_the_editors_pictures_are_said(good):
    verdict = LimitsCritic(None).judge_edit(replace(good, faults=("it is black",)))
    assert verdict.label == "doubtful" and verdict.reason == "it is black"


def test_a_rim_counts_only_where_the_change_beside_it_is_clear_to_see(good):
    """A grey bear that is given the grey of its plinth."""
    stone = torch.full_like(good.before.images[0], 0.5)
    inner = torch.stack([square(left, 3) for left in LEFTS])
    for grey, left in ((0.58, 0), (0.9, 1)):
        after = over(stone, (grey, grey, grey), inner)
        edit = judged(good, before=views(stone), after=views(after), instructions=())
        assert measured(edit)["rim"] == pytest.approx(left, abs=0.01)


def test_what_lies_in_the_shade_is_painted_too(good):
    """A pillar whose right half is darker and stays as it was."""
    shade = torch.where(torch.arange(SIZE) < 48, 1.0, 0.75)
    before = over(good.before.images[0] * shade, (0.4, 0.4, 0.4), 1 - good.masks[0])
    done = torch.stack([square(left) for left in LEFTS]) * (shade == 1)
    edit = judged(good, before=views(before), after=views(over(before, RED, done)))
    assert measured(edit)["unchanged"] > fitted_limits("edit")["unchanged"]


def test_outlines_on_two_photos_may_lie_a_rim_apart(good):
    def shared(apart):
        masks = torch.stack([square(LEFTS[0]), square(LEFTS[1] + apart)])
        return measured(replace(good, masks=masks[None]))["shared"]

    assert shared(0) == shared(2) == 1 and shared(8) < 0.9
