"""Ways to make edits agree, with a pipeline that tints each view in its own way."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from edit3r_diffusers.consistency import edit_consistently
from edit3r_diffusers.pipeline_editor import _pil

import edit3r
from edit3r.contract.errors import SettingsError

SIDE, SHIFT = 160, 24
TINTS = (0.2, -0.1)  # of the two views


@pytest.fixture(scope="module")
def overlapping() -> edit3r.Views:
    """Two crops of one textured picture, so that most of what one shows the other shows too."""
    generator = torch.Generator().manual_seed(0)
    grain = torch.rand(1, 3, SIDE // 4, (SIDE + SHIFT) // 4, generator=generator)
    wide = torch.nn.functional.interpolate(grain, scale_factor=4, mode="bicubic")
    wide = 0.3 + 0.4 * wide[0].clamp(0, 1)
    images = torch.stack((wide[..., :SIDE], wide[..., SHIFT:]))
    lenses = torch.eye(3).expand(1, 2, 3, 3)
    return edit3r.Views(images[None], lenses, ("left.png", "right.png"))


class TintPipeline:
    """Called as a class of diffusers: tints each picture in its own way, or as it is shown by two
    further pictures.
    """

    vae_scale_factor, dtype, _execution_device = 1, torch.float32, torch.device("cpu")

    def __init__(self, first) -> None:
        self.first = np.array(first)
        self.prompts: list[str] = []

    def __call__(self, image, prompt, generator, output_type, num_inference_steps):
        self.prompts.append(prompt)
        shown = image if isinstance(image, list) else [image]
        pictures = [np.array(one, np.float32) / 255 for one in shown]
        if len(shown) > 1:
            tint = (pictures[2] - pictures[1]).mean()
        else:
            same = pictures[0].shape == self.first.shape
            known = same and np.abs(pictures[0] * 255 - self.first).max() < 1
            tint = TINTS[0 if known else 1]
        tinted = torch.from_numpy(pictures[0] + tint).permute(2, 0, 1)
        return SimpleNamespace(images=tinted[None])


def run(views, mode: str) -> tuple[torch.Tensor, TintPipeline]:
    """The changes of the views, and the pipeline, through the editor for any class."""
    chosen = {"model": "x", "pipeline": "Flux2KleinPipeline", "resolution": 0}
    editor = edit3r.build("editor", "diffusers", **chosen, consistency=mode)
    editor._plain = TintPipeline(_pil(views.images[0, 0]))
    edited = editor.edit(views, edit3r.EditRequest("make it brighter"))
    return (edited.images - views.images).mean((2, 3, 4))[0], editor._plain


def test_reference_first_gives_all_views_the_edit_of_the_first(overlapping):
    alone, _ = run(overlapping, "independent")
    led, pipeline = run(overlapping, "reference-first")
    assert alone.tolist() == pytest.approx(TINTS, abs=0.01)
    assert led.tolist() == pytest.approx([TINTS[0]] * 2, abs=0.01)
    first, second = pipeline.prompts
    assert first == "make it brighter"
    assert second.startswith("make it brighter. The second")


def test_a_grid_is_edited_as_one_picture_and_cut_apart_where_it_was_joined(overlapping):
    changes, pipeline = run(overlapping.select([0, 1, 0]), "grid")
    assert len(pipeline.prompts) == 1
    assert changes.tolist() == pytest.approx([TINTS[1]] * 3, abs=0.01)


def test_a_grid_lays_the_masks_like_the_pictures(overlapping):
    masks = torch.rand(1, 2, SIDE, SIDE)
    seen = {}

    def edit(views, request, references):
        seen["same"] = request.masks.shape[-2:] == views.image_size
        return replace(
            views, images=request.masks[:, :, None].expand(-1, -1, 3, -1, -1)
        )

    edited = edit_consistently(
        "grid", False, edit, overlapping, edit3r.EditRequest("x", masks=masks)
    )
    assert seen["same"] and torch.equal(edited.images[:, :, 0], masks)


def test_reference_first_with_a_pipeline_of_one_picture_names_the_way_out(overlapping):
    wanted = r"editor\.consistency: .*flux2-klein, qwen-image-edit.*use grid"
    request = edit3r.EditRequest("x")
    with pytest.raises(SettingsError, match=wanted):
        edit_consistently("reference-first", False, None, overlapping, request)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["reference-first", "grid"])
def test_a_pipeline_of_several_pictures_runs_in_every_way(tiny, overlapping, mode):
    model = str(tiny.flux2_klein())
    editor = edit3r.build(
        "editor", "flux2-klein", model=model, steps=1, resolution=128, consistency=mode
    )
    edited = editor.edit(overlapping, edit3r.EditRequest("paint it red")).images
    assert edited.shape == overlapping.images.shape and torch.isfinite(edited).all()
