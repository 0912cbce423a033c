"""Ways to make edits agree, measured with a pipeline whose disagreement is known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from edit3r_diffusers.consistency import disagreement, edit_consistently

import edit3r
from edit3r.contract.errors import SettingsError
from edit3r.contract.reporting import Report, collecting

SIDE, SHIFT = 160, 24
TINTS = (0.2, -0.1)  # of the two views, which hence disagree by 0.3


@pytest.fixture(scope="module")
def overlapping() -> edit3r.Views:
    """Two crops of one textured picture, so that most of what one shows the other shows too."""
    generator = torch.Generator().manual_seed(0)
    wide = torch.nn.functional.interpolate(
        torch.rand(1, 3, SIDE // 4, (SIDE + SHIFT) // 4, generator=generator),
        scale_factor=4,
        mode="bicubic",
    )
    wide = 0.3 + 0.4 * wide[0].clamp(0, 1)
    images = torch.stack((wide[..., :SIDE], wide[..., SHIFT:]))
    return edit3r.Views(
        images[None], torch.eye(3).expand(1, 2, 3, 3), ("left.png", "right.png")
    )


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
        several = isinstance(image, list)
        pictures = [
            np.array(one, np.float32) / 255 for one in (image if several else [image])
        ]
        if several:
            tint = (pictures[2] - pictures[1]).mean()
        else:
            known = (
                pictures[0].shape == self.first.shape
                and np.abs(pictures[0] * 255 - self.first).max() < 1
            )
            tint = TINTS[0 if known else 1]
        return SimpleNamespace(
            images=torch.from_numpy(pictures[0] + tint).permute(2, 0, 1)[None]
        )


def run(views, mode: str) -> tuple[torch.Tensor, dict, TintPipeline]:
    """Edited images, what the run notes, and the pipeline, through the editor for any class."""
    from edit3r_diffusers.pipeline_editor import _pil

    editor = edit3r.build(
        "editor",
        "diffusers",
        model="x",
        pipeline="Flux2KleinPipeline",
        resolution=0,
        consistency=mode,
    )
    editor._plain = TintPipeline(_pil(views.images[0, 0]))
    report = Report()
    with collecting(report):
        edited = editor.edit(views, edit3r.EditRequest("make it brighter"))
    return edited.images, report.notes["editor.consistency"], editor._plain


def test_reference_first_lowers_the_disagreement_that_independent_edits_are_known_to_have(
    overlapping,
):
    _, alone, _ = run(overlapping, "independent")
    edited, led, pipeline = run(overlapping, "reference-first")
    assert alone["mode"] == "independent" and alone["disagreement"] == pytest.approx(
        0.3, abs=0.01
    )
    assert led["mode"] == "reference-first" and led["disagreement"] < 0.01
    assert torch.allclose(
        edited - overlapping.images, torch.tensor(TINTS[0]), atol=0.01
    )
    assert pipeline.prompts[0] == "make it brighter" and pipeline.prompts[1].startswith(
        "make it brighter. The second"
    )


def test_a_grid_is_edited_as_one_picture_and_cut_apart_where_it_was_joined(overlapping):
    three = overlapping.select([0, 1, 0])
    edited, noted, pipeline = run(three, "grid")
    assert len(pipeline.prompts) == 1 and noted["disagreement"] < 0.01
    assert torch.allclose(edited - three.images, torch.tensor(TINTS[1]), atol=0.01)


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
    with pytest.raises(
        SettingsError,
        match=r"editor\.consistency: .*flux2-klein, qwen-image-edit.*use grid",
    ):
        edit_consistently(
            "reference-first", False, None, overlapping, edit3r.EditRequest("x")
        )


def test_disagreement_is_that_of_the_changes_not_of_the_photos(overlapping):
    photos = overlapping.images[0]
    # another exposure, not another edit
    darker = torch.stack((photos[0], 0.5 * photos[1]))
    assert disagreement(darker, darker + 0.1) == pytest.approx(0, abs=1e-3)
    apart = torch.stack((photos[0] + 0.1, photos[1] - 0.1))
    assert disagreement(photos, apart) == pytest.approx(0.2, abs=5e-3)


def test_disagreement_of_photos_without_common_spots_is_not_measured():
    flat = torch.full((2, 3, 64, 64), 0.5)
    assert disagreement(flat, flat) is None


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["reference-first", "grid"])
def test_a_pipeline_of_several_pictures_runs_in_every_way(tiny, overlapping, mode):
    model = str(tiny.flux2_klein())
    editor = edit3r.build(
        "editor", "flux2-klein", model=model, steps=1, resolution=128, consistency=mode
    )
    edited = editor.edit(overlapping, edit3r.EditRequest("paint it red")).images
    assert edited.shape == overlapping.images.shape and torch.isfinite(edited).all()
