import io
import json
import re

import numpy as np
import pytest
import torch
from edit3r_recolor.api import (
    RecolorParameters,
    RegionRecipe,
    SceneRecipe,
    ViewRecipe,
    write_masks,
)
from edit3r_training.photo_dataset import DrawnPhotos
from edit3r_training.procedural_dataset import ProceduralDataset
from edit3r_training.re10k_dataset import Re10kDataset
from edit3r_training.transforms_dataset import TransformsDataset
from PIL import Image

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import Report, collecting
from edit3r.kit.geometry.cameras import invert_rigid, project, unproject
from edit3r_testing import CONTRACTS, Contract, claims, contract_for

VIEWS = 5
SCENE = ProceduralDataset(
    ProceduralDataset.Settings(image_size=64, context=VIEWS, targets=0, angles=(6, 8))
)[3]
PICTURES = [
    (image.permute(1, 2, 0).numpy() * 255).round().astype(np.uint8)
    for image in SCENE.context
]


def _write_transforms(folder) -> None:
    """The scene in nerfstudio's layout (OpenGL axes)."""
    folder.mkdir(parents=True)
    k = SCENE.context_cameras.intrinsics[0, 0] * 64
    frames = []
    for view, picture in enumerate(PICTURES):
        Image.fromarray(picture).save(folder / f"{view}.png")
        pose = SCENE.context_cameras.c2w[0, view] @ torch.diag(
            torch.tensor([1.0, -1, -1, 1])
        )
        frames.append({"file_path": f"{view}.png", "transform_matrix": pose.tolist()})
    shared = {"fl_x": float(k[0, 0]), "fl_y": float(k[1, 1])}
    shared |= {"cx": 32, "cy": 32, "w": 64, "h": 64}
    (folder / "transforms.json").write_text(json.dumps(shared | {"frames": frames}))


def _chunk_scene(key: str = "scene") -> dict:
    files = []
    for picture in PICTURES:
        buffer = io.BytesIO()
        Image.fromarray(picture).save(buffer, "JPEG", quality=95)
        files.append(torch.frombuffer(bytearray(buffer.getvalue()), dtype=torch.uint8))
    k = SCENE.context_cameras.intrinsics[0]
    w2c = invert_rigid(SCENE.context_cameras.c2w[0])[:, :3].reshape(VIEWS, 12)
    head = torch.stack((k[:, 0, 0], k[:, 1, 1], k[:, 0, 2], k[:, 1, 2]), 1)
    cameras = torch.cat((head, torch.zeros(VIEWS, 2), w2c), 1)
    return {"key": key, "cameras": cameras, "images": files}


def _transforms(root, **settings) -> TransformsDataset:
    defaults = {"image_size": 64, "targets": 1, "angles": (4, 30), "mirror": 0}
    return TransformsDataset(
        TransformsDataset.Settings(root=str(root), **{**defaults, **settings})
    )


def _re10k(root, **settings) -> Re10kDataset:
    defaults = {"image_size": 64, "targets": 1, "gap": (2, 3), "mirror": 0}
    return Re10kDataset(
        Re10kDataset.Settings(root=str(root), **{**defaults, **settings})
    )


def _view_of(image) -> int:
    """The photo of the scene that it is."""
    off = [float((photo - image).abs().mean()) for photo in SCENE.context]
    return off.index(min(off))


def _check_poses(sample) -> None:
    """Relative pose and unit baseline equal the scene's own, up to scale: found by the pictures
    that were drawn.
    """
    own = [_view_of(image) for image in sample.context]
    true = SCENE.context_cameras.c2w[0]
    relative = torch.linalg.inv(true[own[0]]) @ true[own[1]]
    given = sample.context_cameras.c2w[0, 1]
    assert torch.allclose(given[:3, :3], relative[:3, :3], atol=1e-4)
    assert torch.allclose(
        given[:3, 3], relative[:3, 3] / relative[:3, 3].norm(), atol=1e-4
    )


def test_transforms_poses_and_pictures_are_those_of_the_files(tmp_path):
    _write_transforms(tmp_path / "a")
    sample = _transforms(tmp_path)[0]
    assert sample.context.shape == (2, 3, 64, 64)
    assert sample.target.shape == (1, 3, 64, 64)
    _check_poses(sample)


def _write_regions(folder, processed: list[bool]) -> None:
    """A recoloured set whose only object is where the red channel leads, so that masks can be told
    to fit pictures.
    """
    parameters = RecolorParameters()
    region = RegionRecipe(1, parameters, 0.5, 1.0, 1.0, (0, 0, 64, 64))
    views = [
        ViewRecipe(str(view), (1,), 1.0, used) for view, used in enumerate(processed)
    ]
    folder.mkdir(parents=True)
    SceneRecipe(0, "test", (region,), tuple(views)).save(folder / "recolor.json")
    masks = torch.stack(
        [_reddish(torch.from_numpy(picture).permute(2, 0, 1)) for picture in PICTURES]
    )
    write_masks(folder / "masks", [view.name for view in views], [1], masks[None])


def _reddish(image: torch.Tensor) -> torch.Tensor:
    return (image[0] > image[1:].amax(0)).float()


@pytest.mark.parametrize("mirror", [0, 1])
def test_masks_of_a_recoloured_scene_come_with_its_photos(tmp_path, mirror):
    _write_transforms(tmp_path / "data" / "a")
    _write_regions(tmp_path / "regions" / "a", [True] * VIEWS)
    regions = str(tmp_path / "regions")
    sample = _transforms(tmp_path / "data", masks=regions, mirror=mirror)[0]
    assert sample.context_masks.shape == (1, 2, 64, 64)
    assert sample.target_masks.shape == (1, 1, 64, 64)
    images = (*sample.context, *sample.target)
    for image, mask in zip(images, (*sample.context_masks[0], *sample.target_masks[0])):
        assert torch.equal(mask, _reddish(image)) and 0 < mask.mean() < 1


def test_photos_that_the_recolouring_left_out_are_not_used(tmp_path):
    _write_transforms(tmp_path / "data" / "a")
    _write_regions(tmp_path / "regions" / "a", [True, False, True, True, False])
    data = _transforms(tmp_path / "data", masks=str(tmp_path / "regions"))
    for index in range(6):
        sample = data[index]
        for image in (*sample.context, *sample.target):
            assert _view_of(image) in (0, 2, 3)


def test_re10k_poses_and_pictures_are_those_of_the_chunk(tmp_path):
    torch.save([_chunk_scene()], tmp_path / "0.torch")
    _check_poses(_re10k(tmp_path)[0])


@pytest.mark.parametrize("kind", ["transforms", "re10k"])
def test_broken_scenes_are_skipped_and_named(tmp_path, kind):
    if kind == "transforms":
        _write_transforms(tmp_path / "good")
        (tmp_path / "bad").mkdir()
        (tmp_path / "bad" / "transforms.json").write_text("{")
        data = _transforms(tmp_path)
    else:
        bad = _chunk_scene("bad") | {"cameras": torch.zeros(2, 18)}
        torch.save([bad, _chunk_scene("good")], tmp_path / "0.torch")
        (tmp_path / "1.torch").write_bytes(b"no chunk")
        data = _re10k(tmp_path)
    report = Report()
    with collecting(report):
        names = {data[index].name.rsplit("-", 1)[0] for index in range(2)}
    assert names == {"good"}
    assert any("skipped" in warning and "bad" in warning for warning in report.warnings)


def test_a_chunk_that_would_run_code_is_refused(tmp_path):
    class Evil:
        def __reduce__(self):
            return (print, ("owned",))

    torch.save([Evil()], tmp_path / "0.torch")
    with pytest.raises(InputError, match="no readable"):
        len(_re10k(tmp_path))


@pytest.mark.parametrize("make", [_transforms, _re10k])
def test_an_empty_folder_is_an_error_that_names_it(tmp_path, make):
    with pytest.raises(InputError, match=tmp_path.name):
        len(make(tmp_path))


@pytest.mark.parametrize("name", ["re10k", "transforms"])
def test_a_training_begins_with_views_close_to_each_other(tmp_path, name):
    """At the start 1 frame apart; from a quarter of the training on 4."""
    chosen = {"gap": (4, 4), "gap_start": (1, 1), "gap_growth": 0.25, "targets": 0}
    if name == "re10k":
        torch.save([_chunk_scene()], tmp_path / "0.torch")
        data = _re10k(tmp_path, **chosen)
    else:
        _write_transforms(tmp_path / "a")
        data = _transforms(tmp_path, select="gap", **chosen)
    seen = []
    for sample in (data.at_progress(0, 0.0), data.at_progress(0, 0.25), data[0]):
        first, second = (_view_of(image) for image in sample.context)
        seen.append(second - first)
    assert seen == [1, 4, 4]


@pytest.mark.parametrize("mirrored", [False, True])
def test_images_and_poses_fit_each_other_mirrored_or_not(mirrored):
    """A surface point of view 0 projects into view 1 to where the same colour is seen."""
    cameras = SCENE.context_cameras
    drawn = DrawnPhotos(
        "scene", SCENE.context[:2], cameras.c2w[0, :2], cameras.intrinsics[0, :2]
    )
    sample = drawn.sample(2, "scene-0", mirrored)
    unit = 1 / SCENE.context_cameras.c2w[0, 1, :3, 3].norm()
    depth = SCENE.context_depths[:1] * unit
    depth = depth.flip(-1) if mirrored else depth
    cameras = sample.context_cameras
    points = unproject(depth, cameras.intrinsics[0, :1], cameras.c2w[0, :1]).reshape(
        1, -1, 3
    )
    places, _ = project(points, cameras.intrinsics[0, 1:], cameras.c2w[0, 1:])
    grid = (places * 2 - 1).reshape(1, 64, 64, 2)
    pulled = torch.nn.functional.grid_sample(
        sample.context[1:], grid, align_corners=False
    )[0]
    gap = (pulled - sample.context[0]).abs().mean(0)[(grid[0].abs() < 1).all(-1)]
    assert gap.median() < 0.04


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("context", 1), ("targets", -1), ("image_size", 2), ("gap", (9, 2))),
        *(("angles", wrong) for wrong in ((float("nan"), 5), (30, 5), (-5, 5))),
        ("max_fov", float("nan")),
    ],
)
def test_settings_out_of_range_are_refused(tmp_path, name, value):
    with pytest.raises(ValueError):
        _transforms(tmp_path, **{name: value})


def test_frames_of_a_chunk_are_found_by_the_scenes_key(tmp_path):
    torch.save(
        [_chunk_scene("other"), _chunk_scene("wanted")], tmp_path / "000000.torch"
    )
    data = _re10k(tmp_path)
    first, second = data.photos("wanted", (1, 4))
    assert np.abs(second.image - PICTURES[4] / 255).mean() < 0.02  # JPEG
    assert np.allclose(
        first.intrinsics, SCENE.context_cameras.intrinsics[0, 1], atol=1e-5
    )
    assert np.allclose(second.c2w, SCENE.context_cameras.c2w[0, 4], atol=1e-5)
    with pytest.raises(InputError, match="frame 9 was asked for, but it has 5 frames"):
        data.photos("wanted", (0, 9))
    with pytest.raises(InputError, match="no chunk has the scene 'lost'"):
        data.photos("lost", (0,))


@pytest.mark.parametrize(
    ("limit", "reason"),
    [
        ({"baseline": (1e-3, 1e-2)}, "context cameras are .* apart.*setting baseline"),
        ({"baseline": (1e3, 1e4)}, "context cameras are .* apart.*setting baseline"),
        ({"max_fov": 20}, "field of view of .* degrees.*setting max_fov"),
    ],
)
@pytest.mark.parametrize("make", [_transforms, _re10k])
def test_views_that_teach_nothing_are_skipped_with_the_setting_that_says_so(
    tmp_path, make, limit, reason
):
    _write_transforms(tmp_path / "a")
    torch.save([_chunk_scene()], tmp_path / "0.torch")
    report = Report()
    with collecting(report), pytest.raises(InputError, match="none of its 1 scenes"):
        make(tmp_path, **limit)[0]
    assert re.search(reason, report.warnings[0])


def _write_edits(folder) -> None:
    """An editor's image of every photo: its negative."""
    folder.mkdir(parents=True)
    for view, picture in enumerate(PICTURES):
        Image.fromarray(255 - picture).save(folder / f"{view}.png")


@pytest.mark.parametrize("mirror", [0, 1])
def test_an_editor_s_images_come_with_the_photos_they_are_of(tmp_path, mirror):
    _write_transforms(tmp_path / "photos" / "a")
    _write_edits(tmp_path / "edits" / "a")
    edits = str(tmp_path / "edits")
    sample = _transforms(tmp_path / "photos", edits=edits, mirror=mirror)[0]
    assert torch.allclose(sample.edited_context, 1 - sample.context, atol=1e-3)
    assert torch.allclose(sample.edited_target, 1 - sample.target, atol=1e-3)


def test_a_photo_without_its_editor_s_image_is_named(tmp_path):
    _write_transforms(tmp_path / "photos" / "a")
    report = Report()
    with collecting(report), pytest.raises(InputError):
        _transforms(tmp_path / "photos", edits=str(tmp_path / "edits"))[0]
    assert "no edited image" in report.warnings[0]


@pytest.mark.parametrize(
    "claim", sorted({*claims(CONTRACTS["dataset"])} - {*claims(Contract)})
)
@pytest.mark.parametrize("name", ["transforms", "re10k"])
def test_contract(tmp_path, name, claim):
    _write_transforms(tmp_path / "a")
    torch.save([_chunk_scene()], tmp_path / "0.torch")
    own = {"angles": (4, 30)} if name == "transforms" else {"gap": (2, 3)}
    given = {"root": str(tmp_path), "image_size": 64, "targets": 1, **own}
    getattr(contract_for("dataset", name, **given)(), claim)()
