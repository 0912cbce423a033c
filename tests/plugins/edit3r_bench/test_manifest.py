"""The manifest says everything, once, and notices what it was not made with."""

import json
from collections import Counter
from types import SimpleNamespace

import pytest
import torch
from edit3r_bench.generated import GeneratedSettings, build_generated, is_visible
from edit3r_bench.manifest import (
    change_masks,
    hash_of_sample,
    load_item,
    load_sample,
    read_bench_manifest,
    write_bench_manifest,
)

from edit3r.contract.errors import Edit3rError, InputError
from edit3r.contract.interfaces import SceneSample
from edit3r.loading.registry import default_registry
from edit3r_testing import cameras_around


def test_a_generated_scene_has_five_visible_edits_of_the_four_types(manifest, small):
    types = Counter(item.type for item in manifest.items)
    assert types == {"Add": 1, "Remove": 1, "Modify": 2, "Global": 1}
    for item in manifest.items:
        sample = load_sample(item.sample, default_registry())
        assert is_visible(sample, item.type == "Global", small)
    first, second = (own.sample for own in manifest.items if own.type == "Modify")
    assert first.sha256 != second.sha256


def test_the_same_seed_gives_the_same_manifest_and_another_another(manifest, small):
    again = build_generated(1, small, default_registry())
    assert again == manifest
    assert again.sha256 == manifest.sha256
    other = build_generated(1, small.model_copy(update={"seed": 4}), default_registry())
    assert other.sha256 != manifest.sha256


def test_names_and_versions_do_not_make_another_benchmark(manifest):
    renamed = manifest.model_copy(update={"name": "x", "made_with": {}, "notes": {}})
    assert renamed.sha256 == manifest.sha256
    assert manifest.model_copy(update={"image_size": 64}).sha256 != manifest.sha256


def test_what_is_written_is_read_back_and_a_part_may_be_asked_for(
    manifest, manifest_file
):
    assert read_bench_manifest(manifest_file) == manifest
    assert [item.type for item in manifest.limited(1, 2).items] == ["Add", "Remove"]


def load(manifest, record, root):
    return load_item(manifest, record, root, default_registry())


def test_an_item_holds_the_truth_and_where_it_differs(manifest, tmp_path):
    record = next(item for item in manifest.items if item.type == "Remove")
    item = load(manifest, record, tmp_path)
    assert item.inputs == 2
    assert item.photos.count == 4
    difference = (item.truth - item.photos.images[0]).abs().amax(1)
    assert difference[item.masks == 0].max() < 0.01
    assert 0 < item.masks.mean() < 0.9
    assert torch.equal(item.cameras.c2w[0, 0], torch.eye(4))
    assert (item.depths > 0).all()


def test_a_global_edit_has_no_mask(manifest, tmp_path):
    record = next(item for item in manifest.items if item.type == "Global")
    assert load(manifest, record, tmp_path).masks is None


def test_change_masks_reach_a_little_further_than_the_change():
    photos = torch.zeros(1, 3, 40, 80)
    truth = photos.clone()
    truth[:, 1, 20, 20] = 0.5
    masks = change_masks(photos, truth)
    assert masks[0, 18:23, 18:23].all()
    assert masks.sum() == 25


def test_another_image_or_frame_than_the_manifests_is_noticed(manifest, tmp_path):
    record = manifest.items[0]
    sample = record.sample.model_copy(update={"sha256": "0" * 64})
    with pytest.raises(InputError, match="differs from the manifest's"):
        load(manifest, record.model_copy(update={"sample": sample}), tmp_path)
    with pytest.raises(InputError, match="uses frame 99"):
        load(manifest, record.model_copy(update={"inputs": (0, 99)}), tmp_path)


@pytest.mark.parametrize(
    ("whole", "first_item", "words"),
    [
        ({"version": 2}, {}, "version: input should be 1"),
        ({"format": "other"}, {}, "edit3r-bench"),
        ({}, {"type": "Rotate"}, "items.0.type"),
        ({}, {"promt": "x"}, "promt"),
        ({}, {"id": "scene000-global"}, "two items are called"),
        ({}, {"scene": "nowhere"}, "not in the manifest"),
        ({}, {"inputs": (0, -1)}, r"uses frame \[-1\], which its scene does not have"),
        ({}, {"held_back": (-2,)}, r"uses frame \[-2\]"),
        ({}, {"inputs": (0, 1, 1)}, "uses a frame twice"),
        ({}, {"inputs": (0, 5), "sample": None}, r"uses frame \[0\], which"),
        ({}, {"id": "../../escaped"}, "not a plain file name"),
        ({}, {"id": "."}, "not a plain file name"),
    ],
)
def test_a_broken_manifest_is_one_sentence(
    manifest, tmp_path, whole, first_item, words
):
    content = {**manifest.model_dump(mode="json"), **whole}
    last = content["items"][-1]["id"]
    content["items"][0] |= first_item
    text = json.dumps(content).replace("scene000-global", last)
    (tmp_path / "m.json").write_text(text)
    with pytest.raises(Edit3rError, match=words):
        read_bench_manifest(tmp_path / "m.json")


def test_a_manifest_is_written_whole_or_not_at_all(manifest, tmp_path):
    twice = manifest.model_copy(update={"items": manifest.items * 2})
    with pytest.raises(InputError):
        write_bench_manifest(tmp_path / "bench.json", twice)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("rows", "change", "visible"),
    [(1, 0.5, False), (10, 0.5, True), (10, 0.04, False), (60, 0.5, False)],
)
def test_an_edit_is_visible_that_covers_a_fair_part_by_more_than_noise(
    rows, change, visible
):
    before = torch.full((2, 3, 100, 10), 0.2)
    after = before.clone()
    after[:, :, :rows] += change
    edits = {"edited_context": after, "edited_target": after[:0]}
    sample = SimpleNamespace(context=before, **edits)
    assert is_visible(sample, False, GeneratedSettings()) is visible


def test_a_data_set_without_true_edits_makes_no_benchmark():
    images = torch.zeros(2, 3, 8, 8)
    sample = SceneSample(images, images[:0], cameras_around(2), cameras_around(1))
    with pytest.raises(InputError, match="its dataset has no true edits"):
        hash_of_sample(sample)
