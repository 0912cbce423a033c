import pytest
import torch
import torch.nn.functional as F
from edit3r_model.edit_fusion import EditTransport
from edit3r_model.edit_fusion_head import Choices, fuse_colours
from edit3r_model.edited_views import Correspondences, EditedViews
from edit3r_model.matched_unet import convex_upsample

from edit3r.kit.geometry.cameras import pixel_grid

ROWS, COLUMNS, WIDTH = 6, 8, 16
GRID = (2, WIDTH, ROWS, COLUMNS)


@pytest.fixture
def transport():
    torch.manual_seed(0)
    with torch.no_grad():
        yield EditTransport(WIDTH).eval()


@pytest.fixture
def given():
    torch.manual_seed(1)
    tokens, reference = torch.randn(GRID), torch.randn(GRID)
    return {
        "tokens": tokens,
        "reference": reference,
        "coordinates": pixel_grid(GRID[2:], tokens).expand(2, -1, -1, -1),
        "maps": torch.randn(2, 12, ROWS, COLUMNS),
        "colours": torch.rand(2, 9, ROWS, COLUMNS),
    }


def test_no_edit_stays_no_edit(transport, given):
    carried = transport(**given | {"maps": torch.zeros_like(given["maps"])})
    assert (carried.maps == 0).all()


def test_attention_equals_its_definition(transport, given):
    """exp(alike - reach |place - key|^2) over all keys and the null key, mixed over heads, written
    out.
    """
    carried, tokens = transport(**given), given["tokens"]
    query, key = transport._embed(tokens), transport._embed(given["reference"])
    alike = query @ key.mT * transport.temperature.exp()[:, None, None]
    size = torch.tensor([COLUMNS, ROWS])
    cells = pixel_grid(GRID[2:], tokens).reshape(-1, 2) * size
    reach = F.softplus(transport.reach(tokens)).flatten(2)[..., None]
    logits = alike - reach * torch.cdist(cells, cells).square()
    null = transport.null[None, :, None, None].expand(2, -1, ROWS * COLUMNS, 1)
    attention = torch.cat((null, logits), -1).softmax(-1)
    values = torch.cat((given["maps"], given["colours"]), 1).flatten(2).mT[:, None]
    mix = transport.head_mix(tokens).softmax(1).flatten(2)[..., None]
    expected = (mix * (attention[..., 1:] @ values)).sum(1).mT
    found = torch.cat((carried.maps, carried.colours), 1).flatten(2)
    assert torch.allclose(found, expected, atol=1e-4)
    assert torch.allclose(carried.evidence.flatten(2), 1 - attention[..., 0], atol=1e-5)


def test_a_short_reach_takes_what_lies_at_the_matched_place(transport, given):
    transport.reach.bias.fill_(50.0)
    transport.null.fill_(-50.0)
    assert torch.allclose(transport(**given).maps, given["maps"], atol=1e-3)


def test_places_far_outside_the_reference_find_no_evidence(transport, given):
    transport.reach.bias.fill_(3.0)
    far = given["coordinates"] + 2
    carried = transport(**given | {"coordinates": far})
    assert carried.evidence.max() < 1e-3 and carried.maps.abs().max() < 1e-2


def test_convex_upsampling_stays_between_neighbours_and_picks_the_one_it_is_told():
    values = torch.rand(1, 2, 5, 5)
    fine = convex_upsample(values, torch.randn(1, 36, 5, 5))
    assert fine.shape == (1, 2, 10, 10)
    assert fine.min() >= values.min() and fine.max() <= values.max()
    logits = torch.full((1, 36, 5, 5), -50.0)
    logits[:, 16:20] = 50.0  # the centre neighbour for all four fine pixels
    nearest = F.interpolate(values, scale_factor=2, mode="nearest")
    assert torch.allclose(convex_upsample(values, logits), nearest)


def fused(photos, edited, maps, choice=1, inside=0.0, seen=1.0):
    """The second of two views from one place; all of the choice is the carried map, or with 2 the
    reference's colour.
    """
    size = photos[0].shape[1:]
    share = torch.zeros(1, 2, 3, *size)
    share[:, 1, choice] = 1
    same = torch.tensor([1.0, 1, 1, 0, 0, 0]).view(6, 1, 1).expand(1, 2, 6, 1, 1)
    places = pixel_grid(size, photos[0]).expand(1, 2, -1, -1, -1)
    none, everywhere = torch.zeros(1, 2, *size), torch.ones(1, 2, *size)
    matches = Correspondences(places, none + inside, none)
    edited, source = torch.stack(edited)[None], torch.stack(photos)[None]
    views = EditedViews.of(edited, source, same, matches)
    choices = Choices(same, maps, share)
    return fuse_colours(views, choices, everywhere, none + seen)[0, 1]


def test_a_carried_map_changes_no_colour_more_than_the_reference_was_changed():
    """A dark hole was painted green, the darker the more. Bright bark beside it must not turn
    pink.
    """
    hole = torch.linspace(0, 0.1, 16).reshape(4, 4).expand(3, 4, 4)
    green = hole.clone()
    green[1] += 0.6 - 2 * hole[1]
    maps = torch.zeros(1, 2, 12, 4, 4)
    # The same function of green: 0.6 - 2 * 0.7 = -0.8 on the bark.
    maps[:, 1, 4], maps[:, 1, 10] = -2, 0.6
    bark = torch.full((3, 4, 4), 0.7)
    assert torch.equal(fused((hole, bark), (green, bark), maps), bark)
    assert torch.allclose(fused((hole, hole), (green, hole), maps), green, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "off_grey"),
    [(0.4, 0.02), (0.1, 0.12), (0.0, 0.2)],  # the grass is off grey by .2
    ids=["wholly", "in part", "not at all"],
)
def test_what_the_reference_never_met_gets_no_stronger_colour_than_its_edit_made(
    change, off_grey
):
    """Red bricks became a drawing on paper that is off grey by .02; the map makes grass lighter."""
    bricks = torch.tensor([0.6, 0.3, 0.3])[:, None, None].expand(3, 4, 4)
    paper = torch.tensor([0.93, 0.9, 0.9])[:, None, None].expand(3, 4, 4)
    grass = torch.tensor([0.2, 0.5, 0.2])[:, None, None].expand(3, 4, 4)
    maps = torch.zeros(1, 2, 12, 4, 4)
    maps[:, 1, 9:] = change
    shown = fused((bricks, grass), (paper, grass + 0.4), maps)
    off = (shown - shown.mean(0)).abs().amax(0)
    assert torch.allclose(off, torch.full((4, 4), off_grey), atol=1e-5)


def test_the_share_of_the_reference_s_colour_goes_to_the_map_where_it_shows_no_edit():
    """The reference is edited on its left alone; all of the choice is its colour, warped."""
    photo = torch.full((3, 4, 24), 0.3)
    edited = photo.clone()
    edited[..., :12] += 0.4
    maps = torch.zeros(1, 2, 12, 4, 24)
    maps[:, 1, 9:] = 0.2  # the carried change of each channel, everywhere
    shown = fused((photo, photo), (edited, photo), maps, choice=2, inside=1.0)
    assert torch.allclose(shown[..., :8], edited[..., :8], atol=1e-5)
    assert torch.allclose(shown[..., 18:], photo[..., 18:] + 0.2, atol=1e-5)


@pytest.mark.parametrize(
    ("seen", "carried", "expected"),
    [
        (0, 0.0, 0.5),  # nothing is carried, and nothing shown contradicts its own edit
        (1, 0.0, 0.3),  # the reference shows the place without an edit
        (0, -0.2, 0.1),  # as large as its own edit, and the other way
    ],
)
def test_nothing_carried_takes_no_edit_back_where_the_reference_shows_nothing(
    seen, carried, expected
):
    """The view made all of itself brighter; all of the choice is the carried map."""
    photo = torch.full((3, 4, 4), 0.3)
    maps = torch.zeros(1, 2, 12, 4, 4)
    maps[:, 1, 9:] = carried
    edited = photo + carried, photo + 0.2
    shown = fused((photo, photo), edited, maps, seen=seen)
    assert torch.allclose(shown, torch.full_like(shown, expected), atol=1e-5)
