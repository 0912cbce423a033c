"""What is meant on one picture is carried to all by the scene's Gaussians."""

from dataclasses import replace

import pytest
import torch
from edit3r_in_place import in_scene
from edit3r_in_place.belonging import SHARE, belonging, evidence, with_specks
from edit3r_in_place.in_scene import InSceneSelector, _Lifting, _part_of_scene

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Candidate, Geometry, Selected, Selection
from edit3r.contract.types import Views
from edit3r.kit.geometry.maps import dilate
from edit3r.kit.scenes.scene_views import look_around, pictures_of
from tests.plugins.scan import of_ball, scan

SIZE = (56, 72)


def red_on(images):
    """Where pictures are red."""
    red, green, blue = images.unbind(1)
    return ((red > 1.8 * green) & (red > 1.8 * blue)).float()


class Asked:
    """The usual selector, which takes what is red on the pictures it is shown."""

    def __init__(self):
        self.pictures = []

    def select(self, views, selection, geometry=None):
        self.pictures.append(views.count)
        masks = red_on(views.images[0])
        return Selected(masks[:, None], ("marked",) * views.count, confidence=0.8)


@pytest.fixture(scope="module")
def scene():
    rasterizer = edit3r.build("rasterizer", "numba")
    places = look_around(scan(), rasterizer, count=8, size=SIZE)
    return pictures_of(scan(), places, rasterizer).scene


@pytest.fixture
def selector(scene):
    built = edit3r.build("selector", "in-scene")
    built.usual = Asked()
    return built.starting_from(scene)


def on_ball(scene, view=0):
    """A click on the red ball of a picture."""
    red, green, _ = scene.images[0, view].unbind(0)
    height, width = SIZE
    row, column = divmod(int((red - green).argmax()), width)
    place = (column + 0.5) / width, (row + 0.5) / height
    return Selection(positive=((view, *place),))


def test_one_click_selects_the_thing_on_all_pictures_and_few_are_looked_at(
    scene, selector
):
    views = Views(scene.images, scene.cameras.intrinsics)
    found = selector.select(views, on_ball(scene, 3))
    true = red_on(scene.images[0]) > 0
    masks = found.masks[:, 0] > 0.5
    shows = true.sum((1, 2)) > 10  # else the other ball stands before it
    both, either = (one.sum((1, 2))[shows] for one in (masks & true, masks | true))
    overlaps = both / either
    assert overlaps.min() > 0.75
    assert sum(selector.usual.pictures) <= 3
    assert found.how == ("geometry",) * 3 + ("marked",) + ("geometry",) * 4
    assert torch.equal(found.masks[3, 0], true[3].float())  # obeyed to the pixel
    assert found.confidence == 0.8


class AllOfIt(Asked):
    """What stands out most is the scene; what is red is the second candidate."""

    def select(self, views, selection, geometry=None):
        found = super().select(views, selection, geometry)
        masks = [torch.ones_like(found.masks[0, 0]), found.masks[0, 0]]
        candidates = tuple(
            Candidate(0, mask, 0.5, k + 1) for k, mask in enumerate(masks)
        )
        taken = masks[min(selection.candidate, 2) - 1] if selection.positive else None
        if taken is None or views.count > 1:
            return found
        return replace(found, masks=taken[None, None], candidates=candidates)


@pytest.mark.parametrize(("words", "share"), [("jacket", 0.3), ("", 0.9)])
def test_a_name_beside_a_click_is_that_of_a_part_of_the_scene(
    scene, selector, words, share
):
    selector.usual = AllOfIt()
    views = Views(scene.images, scene.cameras.intrinsics)
    found = selector.select(views, replace(on_ball(scene), words=words))
    alphas = scene.alphas[0, 0]
    covered = float((found.masks[0, 0] * alphas).sum() / alphas.sum())
    assert (covered > share) == (not words)


def test_candidates_are_of_the_picture_that_was_marked(scene, selector):
    selector.usual = AllOfIt()
    views = Views(scene.images, scene.cameras.intrinsics)
    found = selector.select(views, on_ball(scene, 3))
    assert [one.view for one in found.candidates] == [3, 3]


def test_the_rest_is_selected_where_the_selection_is_inverted(scene, selector):
    views = Views(scene.images, scene.cameras.intrinsics)
    marks = on_ball(scene)
    plain = selector.select(views, marks).masks
    inverted = selector.select(views, replace(marks, inverted=True)).masks
    assert torch.allclose(plain + inverted, torch.ones_like(plain))


def test_what_no_picture_shows_belongs_to_what_is_nearest(scene):
    rasterizer = edit3r.build("rasterizer", "numba")
    mask = red_on(scene.images[0, :1])
    shown = evidence(scene.gaussians, scene.cameras.select([0]), mask, rasterizer)
    ball = of_ball(scene.gaussians, 0)
    hidden = ball & ~shown.seen
    assert hidden.any()
    chosen = belonging(scene.gaussians, shown) > SHARE
    assert chosen[hidden].float().mean() > 0.8
    assert chosen[of_ball(scene.gaussians, 1)].float().mean() < 0.02


def test_what_shows_beside_or_through_a_thing_far_behind_it_is_not_the_thing(scene):
    """A mask that is two pixels too wide takes the ball, and little of the floor behind it."""
    rasterizer = edit3r.build("rasterizer", "numba")
    mask = red_on(scene.images[0, :1])
    wide, camera = dilate(mask, 2), scene.cameras.select([0])
    taken = _Lifting(scene, rasterizer).evidence_of({0: wide[0]}).within
    plain = evidence(scene.gaussians, camera, wide, rasterizer).within
    ball = of_ball(scene.gaussians, 0)
    assert taken[ball].sum() > 0.9 * plain[ball].sum()
    assert taken[~ball].sum() < 0.8 * plain[~ball].sum()


def test_specks_of_a_thing_go_with_it_and_what_it_stands_on_stays(scene):
    ball = of_ball(scene.gaussians, 0)
    chosen = ball.clone()
    chosen[:300:20] = False
    assert torch.equal(with_specks(scene.gaussians, chosen), ball)


def test_a_click_on_the_background_is_refused(scene, selector):
    views = Views(scene.images, scene.cameras.intrinsics)
    with pytest.raises(InputError, match="on nothing"):
        selector.select(views, Selection(positive=((0, 0.01, 0.01),)))


def test_without_a_scene_the_usual_selector_answers():
    built = edit3r.build("selector", "in-scene")
    assert isinstance(built, InSceneSelector)
    built.usual = Asked()
    views = Views(torch.rand(1, 2, 3, 16, 16), torch.eye(3).expand(1, 2, 3, 3))
    built.select(views, Selection(positive=((0, 0.5, 0.5),)))
    assert built.usual.pictures == [2]


def test_of_several_parts_of_the_scene_a_name_takes_the_likeliest(scene):
    whole, part = torch.ones(SIZE), torch.zeros(SIZE)
    part[20:40, 20:40] = 1
    masks = (whole, part, 0.5 * part)
    found = Selected(
        whole[None, None],
        ("marked",),
        candidates=tuple(
            Candidate(0, mask, 0.3, k + 1) for k, mask in enumerate(masks)
        ),
    )
    asked = replace(on_ball(scene), words="jacket")
    assert _part_of_scene(found, asked, scene.alphas[0, :1]) == 2


def test_the_background_about_a_scene_is_no_candidate(selector):
    """Words that nothing knows mean what stands out: never the nothing about a scene."""

    class StandsOut(Asked):
        def select(self, views, selection, geometry=None):
            self.pictures.append(selection.candidate)
            red = red_on(views.images[0])
            empty = (selector.scene.alphas[0, : views.count] < 0.2).float()
            masks = (empty, red, 0.9 * red)
            options = (Candidate(0, one[0], 0.2, k + 1) for k, one in enumerate(masks))
            chosen = masks[selection.candidate - 1][:, None]
            how = ("guess",) * views.count
            return Selected(chosen, how, confidence=0.2, candidates=tuple(options))

    selector.usual = StandsOut()
    views = Views(selector.scene.images, selector.scene.cameras.intrinsics)
    found = selector.select(views, Selection(words="thing"))
    assert selector.usual.pictures == [1, 2]
    red = red_on(selector.scene.images[0])[0]
    assert (found.masks[0, 0] * red).sum() > 0.9 * red.sum()
    assert [one.number for one in found.candidates] == [1, 2]
    assert (found.confidence, found.taken) == (0.2, 1)
    second = selector.select(views, Selection(words="thing", candidate=2))
    assert selector.usual.pictures[2:] == [2, 3] and second.taken == 2


@pytest.mark.parametrize(("around", "taken"), [(6, True), (5, False)])
def test_a_speck_is_what_most_of_its_neighbours_do_not_count_itself(around, taken):
    """Of eight neighbours six belong to the thing (0.75 > 0.7), or five."""
    angles = torch.arange(8) * torch.pi / 4
    ring = torch.stack((angles.cos(), angles.sin(), 0 * angles), 1)
    far = torch.tensor([[30.0, 0, 0], [-30, 0, 0], [0, 30, 0], [0, -30, 0]])
    means = torch.cat((torch.zeros(1, 3), ring, far))
    plain = scan().select(torch.arange(len(means)))
    chosen = torch.zeros(len(means), dtype=torch.bool)
    chosen[1 : 1 + around] = True
    chosen[9:] = True
    grown = with_specks(replace(plain, means=means[None]), chosen)
    assert bool(grown[0]) == taken


@pytest.mark.parametrize(
    ("count", "taken"), [(2, [0, 1]), (4, [0, 1, 2]), (8, [0, 3, 6]), (10, [0, 3, 6])]
)
def test_the_pictures_on_which_words_are_looked_for_are_far_apart(count, taken):
    assert in_scene._spread(count, 3) == taken


def test_marks_of_all_kinds_and_geometry_go_with_their_pictures():
    mask = torch.rand(6, 8)
    marks = Selection(
        positive=((5, 0.1, 0.2), (2, 0.3, 0.4)),
        negative=((2, 0.5, 0.6),),
        strokes=((5, ((0.1, 0.2), (0.3, 0.4))),),
        regions=((2, (0.1, 0.2, 0.3, 0.4)),),
        boxes={5: (0.1, 0.2, 0.3, 0.4)},
        added={2: mask},
        removed={5: mask},
        masks={2: 1 - mask},
    )
    there = in_scene._renumbered(marks, {2: 0, 5: 1})
    assert there.positive == ((1, 0.1, 0.2), (0, 0.3, 0.4))
    assert there.negative == ((0, 0.5, 0.6),)
    assert (there.strokes[0][0], there.regions[0][0]) == (1, 0)
    assert [list(getattr(there, name)) for name in ("boxes", "added")] == [[1], [0]]
    assert [list(getattr(there, name)) for name in ("removed", "masks")] == [[1], [0]]
    assert in_scene._renumbered(there, {0: 2, 1: 5}) == marks
    numbers = torch.arange(6.0)[None, :, None, None].expand(1, 6, 4, 4)
    lens, depths = numbers[..., :3, :3] + 10, numbers + 20
    known = Geometry(numbers, depths, 0.01 * numbers, numbers[..., 0, 0] > 2, lens)
    part = in_scene._of_views(known, [5, 2])
    for name in ("c2w", "depths", "confidence", "registered", "intrinsics"):
        assert torch.equal(getattr(part, name), getattr(known, name)[:, [5, 2]])


def test_a_further_look_clicks_the_innermost_place_of_what_is_surely_there():
    expected = torch.zeros(20, 40)
    expected[3:14, 6:31] = 0.6  # it shows, and is surely there in a part
    expected[5:10, 24:29] = 0.95
    assert in_scene._inner(expected) == [(26.5 / 40, 7.5 / 20)]
    faint = expected.clamp(max=0.85)
    ((x, y),) = in_scene._inner(faint)
    assert y == 8.5 / 20 and 11 / 40 < x < 26 / 40


@pytest.mark.parametrize(("shared", "other", "same"), [(11, 0, True), (12, 2, False)])
def test_a_further_look_that_finds_something_else_is_not_taken(
    selector, shared, other, same
):
    """Of 20 pixels that are expected 11 are enough, not 12 of 22."""
    expected = torch.zeros(10, 30)
    expected[4, 5:25] = 0.9
    mask = torch.zeros(10, 30)
    mask[4, 5 : 5 + shared] = mask[7, :other] = 1
    asked = []

    def select(views, marks, geometry):
        asked.append(marks)
        return Selected(mask[None, None], ("marked",))

    selector.usual.select = select
    view = Views(torch.rand(1, 1, 3, 10, 30), torch.eye(3).expand(1, 1, 3, 3))
    found = selector._look_again(view, Selection(), expected)
    assert found is None if not same else torch.equal(found, mask)
    assert asked[0].boxes == {0: (5 / 30, 4 / 10, 20 / 30, 1 / 10)}


@pytest.mark.parametrize("kind", ["click", "stroke"])
def test_a_mark_at_the_edge_or_of_a_picture_that_is_not_there_is_let_through(
    scene, kind
):
    alphas = torch.zeros_like(scene.alphas)
    alphas[0, 1, -1, -1] = in_scene.SOLID
    there = replace(scene, alphas=alphas)

    def checked(view, x, y):
        marks = (
            {"positive": ((view, x, y),)}
            if kind == "click"
            else {"strokes": ((view, ((x, y), (0.0, 0.0))),)}
        )
        in_scene._check_places(Selection(**marks), there)

    checked(1, 1.0, 1.0)
    checked(len(alphas[0]), 0.5, 0.5)
    with pytest.raises(InputError, match="picture 2 lies on nothing"):
        checked(1, 1.0, 0.5)
