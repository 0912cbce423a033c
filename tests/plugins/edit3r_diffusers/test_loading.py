"""What can go wrong while loading or running, each told in a sentence that names the way out."""

import pytest
import torch
from edit3r_diffusers import loading

import edit3r
from edit3r.contract.errors import (
    InputError,
    MissingDependencyError,
    RunError,
    SettingsError,
)
from edit3r.kit.weights import load as pretrained

ASK = edit3r.EditRequest("paint it red")


def built(**settings):
    return edit3r.build("editor", "instruct-pix2pix", **{"steps": 1} | settings)


def edit_with(views, **settings):
    return built(**settings).edit(views, ASK)


def test_a_model_that_was_never_downloaded_is_one_sentence_with_the_command(two_views):
    command = "edit3r weights get instruct-pix2pix"
    with pytest.raises(MissingDependencyError, match=command):
        edit_with(two_views, local_files_only=True)


def test_a_missing_folder_and_a_folder_of_something_else_are_told_apart(
    two_views, tmp_path
):
    with pytest.raises(InputError, match=r"editor\.model: no folder"):
        edit_with(two_views, model=str(tmp_path / "nothing"))
    said = "does not hold a StableDiffusionInstructPix2PixPipeline"
    with pytest.raises(InputError, match=said):
        edit_with(two_views, model=str(tmp_path))


def test_a_gated_model_names_the_login_command():
    weights = pretrained.ChosenWeights("x/y", "editor.model")
    gated = OSError("Access to model x/y is gated")
    error = pretrained.loading_error(gated, object, weights)
    assert "hf auth login" in str(error) and isinstance(error, MissingDependencyError)


@pytest.mark.skipif(
    torch.cuda.is_available(),
    reason="this machine has the device the test expects missing",
)
def test_a_device_that_is_not_there_is_a_sentence(tiny, two_views):
    said = r"editor\.device: 'cuda' cannot be used .* editor\.device=cpu"
    with pytest.raises(SettingsError, match=said):
        edit_with(two_views, model=str(tiny.instruct_pix2pix()), device="cuda")


def test_offloading_without_a_gpu_is_a_sentence(tiny, two_views):
    with pytest.raises(SettingsError, match=r"editor\.offload=none"):
        edit_with(two_views, model=str(tiny.instruct_pix2pix()), offload="model")


def test_running_out_of_memory_names_the_settings_that_help(tiny, two_views):
    editor = built(model=str(tiny.instruct_pix2pix()), resolution=0)
    unet = editor._loaded(torch.device("cpu")).unet

    def forward(*args, **kwargs):
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2 GiB.")

    unet.forward = forward
    said = r"out of memory while editing left.png at 32x32; .*editor\.offload=model"
    with pytest.raises(RunError, match=said):
        editor.edit(two_views, ASK)


@pytest.mark.slow
def test_half_precision_that_overflows_is_a_sentence(tiny, two_views):
    editor = built(model=str(tiny.instruct_pix2pix()), resolution=0)
    decoder = editor._loaded(torch.device("cpu")).vae.decoder
    with torch.no_grad():
        decoder.conv_out.bias.fill_(float("nan"))
    with pytest.raises(RunError, match=r"edit of left.png .* editor\.dtype=float32"):
        editor.edit(two_views, ASK)


@pytest.mark.slow
def test_low_memory_gives_the_same_picture(tiny, two_views):
    given = {"model": str(tiny.instruct_pix2pix()), "resolution": 0}
    plain, low = (
        edit_with(two_views, **given, low_memory=low).images for low in (False, True)
    )
    assert torch.allclose(low, plain, atol=1e-4)


def test_auto_dtype_is_half_only_off_the_cpu():
    cpu, cuda = map(torch.device, ("cpu", "cuda"))
    assert loading.pick_dtype("auto", cpu, torch.float16) is torch.float32
    assert loading.pick_dtype("auto", cuda, torch.bfloat16) is torch.bfloat16
    assert loading.pick_dtype("float16", cpu, torch.bfloat16) is torch.float16
