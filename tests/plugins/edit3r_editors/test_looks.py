"""Named looks: which one a prompt means, and that a look follows the surfaces and not the picture's
frame.
"""

import numpy as np
import pytest
import torch
from edit3r_editors.looks import LOOKS, look_of
from skimage import data

from edit3r.cli.main import main
from edit3r.contract.errors import PromptError, SettingsError
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.photos.images import packaged_pair
from edit3r.loading.registry import build
from edit3r.running.editors import read

PHOTO = torch.from_numpy(
    data.astronaut()[:256, 100:420].astype(np.float32) / 255
).permute(2, 0, 1)
VIEWS = Views(
    torch.stack((PHOTO, PHOTO.flip(2)))[None],
    torch.eye(3).expand(1, 2, 3, 3),
    ("a", "b"),
)


@pytest.mark.parametrize(
    ("prompt", "look"),
    [
        ("make it look like autumn", "autumn"),
        ("As a pencil sketch, please!", "sketch"),
        ("marble", "marble"),
        ("turn the whole scene into a cartoon", "cartoon"),
        ("a watercolour painting", "watercolour"),
        ("black and white", "greyscale"),
        ("paint it gold", "gold"),
        ("make the planter look old and weathered", "weathered"),
        ("make the door look worn", "weathered"),
        ("turn the bear into marble", "marble"),
        ("make the bear wooden", "wood"),
        ("turn the bear into snow", "snow"),
        ("blur the faces", "blur"),
        ("blur out the man's face", "blur"),
        ("make the number plate blurry", "blur"),
        ("pixelate the number plate", "pixelate"),
        ("I want the bear pixelated", "pixelate"),
        ("make it look like mars", ""),
        ("autumn or rather winter", ""),
        ("paint the bear red", ""),
        ("remove the bear", ""),
    ],
)
def test_a_instruction_names_a_look_or_is_not_understood(prompt, look):
    (instruction,) = read(prompt)
    assert look_of(instruction) == look
    assert build("editor", "looks").understands(instruction) == bool(look)


def test_what_names_no_look_is_an_error_with_the_looks_there_are():
    with pytest.raises(
        PromptError, match=r"names no look.*Did you mean 'autumn'"
    ) as caught:
        edited("make it look like autunm")
    assert all(look in str(caught.value) for look in LOOKS)


def test_a_look_stays_in_the_region_of_its_instruction():
    regions = torch.zeros(1, 1, 2, *VIEWS.image_size)
    regions[..., :100] = 1
    request = EditRequest(
        "the fox as a sketch", instructions=read("the fox as a sketch"), regions=regions
    )
    images = build("editor", "looks").edit(VIEWS, request).images
    assert torch.equal(images[..., 100:], VIEWS.images[..., 100:])
    assert (images[..., :100] - VIEWS.images[..., :100]).abs().mean() > 0.02


def edited(prompt="", **settings) -> torch.Tensor:
    instructions = read(prompt) if prompt else ()
    request = EditRequest(prompt, instructions=instructions)
    return build("editor", "looks", **settings).edit(VIEWS, request).images


@pytest.mark.parametrize("look", [one for one in LOOKS if not LOOKS[one].hides])
def test_a_look_is_clearly_seen_and_alike_wherever_a_surface_lies_in_the_picture(look):
    """Cut the photo elsewhere, or mirror it, and every surface keeps its look."""
    drawn = edited(look=look)[0, 0]
    assert (drawn - PHOTO).abs().mean() > 0.02
    moved = LOOKS[look].draw(PHOTO[None, :, 7:, 13:])[0]
    inside = slice(24, -24)
    assert (drawn[:, 7:, 13:] - moved)[:, inside, inside].abs().mean() < 0.012


@pytest.mark.slow
def test_looks_differ_from_each_other():
    drawn = torch.stack([edited(look=look)[0, 0] for look in LOOKS])
    apart = (drawn[:, None] - drawn[None]).abs().mean((2, 3, 4)) + torch.eye(len(LOOKS))
    assert apart.min() > 0.02


@pytest.mark.parametrize(
    ("look", "green"),
    [
        ("autumn", lambda c: c[0] > c[1] > c[2]),
        ("winter", lambda c: max(c) - min(c) < 0.2),
    ],
)
def test_seasons_change_what_is_green(look, green):
    meadow = torch.tensor([0.25, 0.5, 0.2])[:, None, None].expand(1, 3, 24, 24)
    assert green(LOOKS[look].draw(meadow)[0, :, 12, 12].tolist())


def test_greyscale_is_grey_and_strength_is_the_share_of_a_look():
    grey = edited("black and white")
    assert (grey - grey.mean(2, keepdim=True)).abs().max() < 1e-5
    assert torch.equal(edited("night", strength=0), VIEWS.images)
    assert torch.allclose(
        edited("night", strength=0.5), 0.5 * (VIEWS.images + edited("night")), atol=1e-6
    )


def test_what_was_understood_is_noted():
    with collecting(Report()) as report:
        edited("make it look like autumn")
    assert report.notes["look"].startswith("autumn: ")


def test_an_unknown_look_is_refused_before_any_photo_is_read():
    with pytest.raises(SettingsError, match=r"editor\.look"):
        build("editor", "looks", look="mars")


def test_describe_lists_every_look(capsys):
    assert main(["describe", "editor", "looks"]) == 0
    told = capsys.readouterr().out
    assert all(look in told for look in LOOKS)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (["--editor", "looks", "--prompt", "like mars"], "is not understood"),
        ([], "there is nothing to do"),
        (
            [
                "--prompt",
                "paint the door green and the wall white",
                "--point",
                "100,100",
            ],
            "names 'door' and 'wall'",
        ),
        (["--prompt", "from green to brown", "--point", "100,100"], "near green"),
    ],
)
def test_what_cannot_be_carried_out_ends_with_exit_code_2_and_leaves_nothing(
    flags, says, tmp_path, capsys
):
    code, said = ended(flags, tmp_path, capsys)
    assert code == 2 and says in said and not [*tmp_path.iterdir()]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (["--editor", "looks", "--prompt", "turn the gnome into gold"], "'gnome'?"),
        (["--prompt", "paint the fxo red"], "Did you mean 'fox'?"),
    ],
)
def test_words_that_nobody_knows_are_asked_about_with_a_sheet_and_three_ways_on(
    flags, says, tmp_path, capsys
):
    code, said = ended(flags, tmp_path, capsys)
    assert code == 3 and says in said and "nothing was edited" in said
    assert all(way in said for way in ("--candidate 1", "--point", "weights get words"))
    assert [file.name for file in tmp_path.iterdir()] == ["out-question.png"]
    code, said = ended([*flags, "--guess"], tmp_path, capsys)
    # at 64 pixels nothing matches
    assert code != 3 and "nothing was edited" not in said


def ended(flags, tmp_path, capsys):
    """Exit code of a run of the packaged pair, and what it said."""
    photos = [str(file) for file in packaged_pair()[0]]
    out = ["--size", "64", "--quiet", "--out", str(tmp_path / "out")]
    return main(["run", *photos, *out, *flags]), capsys.readouterr().err
