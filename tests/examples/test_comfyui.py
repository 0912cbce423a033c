"""The nodes for ComfyUI, loaded and called in the way that ComfyUI does."""

import importlib.util
import inspect
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from PIL import Image

from edit3r.contract.errors import InputError, SettingsError
from edit3r.kit.photos.images import packaged_pair

FOLDER = Path(__file__).parents[2] / "examples" / "edit3r-comfyui"
QUICK = "{size: 64, gaussians: all, refine: 2, frames: 2, outputs: [scene]}"


@pytest.fixture(scope="module")
def nodes(tmp_path_factory):
    """The classes by name; ComfyUI's own module says where results go."""
    output = tmp_path_factory.mktemp("output")
    own = ModuleType("folder_paths")
    own.get_output_directory = lambda: str(output)
    name = str(FOLDER).replace(".", "_x_")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "folder_paths", own)
        spec = importlib.util.spec_from_file_location(name, FOLDER / "__init__.py")
        module = importlib.util.module_from_spec(spec)
        patch.setitem(sys.modules, name, module)
        spec.loader.exec_module(module)
        assert set(module.NODE_CLASS_MAPPINGS) == set(module.NODE_DISPLAY_NAME_MAPPINGS)
        yield module.NODE_CLASS_MAPPINGS
        sys.modules.pop(f"{name}.nodes")


def call(node, **inputs):
    """What a node gives, by the name of the output."""
    with torch.inference_mode():
        given = getattr(node(), node.FUNCTION)(**inputs)
    assert len(given) == len(node.RETURN_TYPES)
    return dict(zip(node.RETURN_NAMES, given))


@pytest.fixture(scope="module")
def images():
    """A batch of two small photos, `[2, 64, 96, 3]`."""
    small = [Image.open(photo).resize((96, 64)) for photo in packaged_pair()[0]]
    pixels = np.stack([np.asarray(image.convert("RGB")) for image in small])
    return torch.from_numpy(pixels).float() / 255


@pytest.fixture(scope="module")
def edited(nodes, images):
    inputs = {"images": images, "prompt": "make it warmer", "seed": 1}
    return call(nodes["Edit3rEdit"], **inputs, settings=QUICK)


def test_every_input_is_a_parameter_and_of_a_type_that_comfyui_has(nodes):
    known = {"IMAGE", "MASK", "STRING", "INT"}
    for node in nodes.values():
        kinds = node.INPUT_TYPES()
        inputs = {**kinds["required"], **kinds.get("optional", {})}
        parameters = inspect.signature(getattr(node, node.FUNCTION)).parameters
        assert list(parameters)[1:] == list(inputs)
        assert {*node.RETURN_TYPES, *(kind for kind, *_ in inputs.values())} <= known


def test_the_edit_node_makes_a_scene_and_previews(edited, images):
    assert Path(edited["scene"]).is_file()
    for name in ("edited", "rendered"):
        made = edited[name]
        assert (
            made.shape[0] == 2 and made.shape[-1] == 3 and made.dtype == torch.float32
        )
        assert made.min() >= 0 and made.max() <= 1
    red, _, blue = (edited["edited"].mean((0, 1, 2)) - images.mean((0, 1, 2))).tolist()
    assert red > blue  # warmer
    lines = edited["verdict"].splitlines()
    assert [line.split(":")[0] for line in lines[-2:]] == ["edit", "scene"]


def test_the_render_node_shows_the_scene(nodes, edited):
    frames = call(nodes["Edit3rRender"], scene=edited["scene"], frames=3)["frames"]
    assert frames.shape == (3, *edited["rendered"].shape[1:])
    assert (frames[0] - edited["rendered"][0]).abs().mean() < 0.1
    assert frames.std() > 0.05


@pytest.mark.slow
def test_pixels_outside_of_the_mask_stay(nodes, images):
    mask = torch.zeros(2, 64, 96)
    mask[:, :, :48] = 1
    given = call(
        nodes["Edit3rEdit"],
        images=images,
        prompt="make it much darker",
        seed=1,
        mask=mask,
        settings=QUICK,
    )["edited"]
    before = torch.nn.functional.interpolate(
        images.movedim(-1, 1), given.shape[1:3], mode="area"
    ).movedim(1, -1)
    middle = given.shape[2] // 2
    change = (given - before).abs().mean((0, 1, 3))
    assert change[: middle - 2].mean() > 5 * change[middle + 2 :].mean()


@pytest.mark.parametrize(
    "wrong, told",
    [
        ({"images": None}, "images: expected two or more photos.*NoneType"),
        ({"images": torch.rand(64, 96, 3)}, r"images: expected.*\[64, 96, 3\]"),
        ({"images": torch.full((2, 64, 96, 3), torch.nan)}, "images: .*finite"),
        ({"mask": torch.ones(3, 64, 96)}, r"mask: .*a photo \(2\).*\[3, 64, 96\]"),
        ({"mask": torch.ones(2, 32, 32)}, r"mask: .*\[64, 96\] like the images"),
        ({"mask": torch.full((2, 64, 96), torch.nan)}, "mask: .*finite"),
        ({"settings": "size: [1"}, "settings: not YAML"),
        ({"settings": "- size"}, "settings: expected lines such as"),
        ({"settings": "siz: 64"}, "settings: 'siz' is none; there are .*size"),
        ({"settings": "prompt: x"}, "settings: 'prompt' is none"),
    ],
)
def test_the_input_that_is_wrong_is_named(nodes, images, wrong, told):
    inputs = {"images": images, "prompt": "make it warmer", "seed": 1, **wrong}
    with pytest.raises(InputError, match=told):
        call(nodes["Edit3rEdit"], **inputs)


def test_a_scene_that_is_not_there_is_named(nodes):
    with pytest.raises(InputError, match=r"scene: '/nope\.ply' is no file"):
        call(nodes["Edit3rRender"], scene="/nope.ply", frames=3)


def test_settings_of_a_workflow_name_no_program(nodes, images, tmp_path):
    """A workflow may be a stranger's."""
    made = tmp_path / "made"
    with pytest.raises(SettingsError, match=r"editor\.command"):
        call(
            nodes["Edit3rEdit"],
            images=images,
            prompt="make it warmer",
            seed=1,
            settings=f"editor: {{name: command, command: 'touch {made}'}}",
        )
    assert not made.exists()
