"""The manifest says everything, once, and notices what it was not made with."""

import json
from collections import Counter

import pytest
import torch
from edit3r_measure.bench_build import build_generated, is_visible
from edit3r_measure.bench_manifest import (
    EDIT_TYPES,
    change_masks,
    load_item,
    load_sample,
    read_bench_manifest,
    write_bench_manifest,
)

from edit3r.errors import InputError, SettingsError
from edit3r.plugins.registry import default_registry


def test_a_generated_scene_has_five_visible_edits_of_the_four_types(manifest, small):
    assert Counter(item.type for item in manifest.items) == {
        "Add": 1,
        "Remove": 1,
        "Modify": 2,
        "Global": 1,
    }
    assert {item.type for item in manifest.items} == set(EDIT_TYPES)
    for item in manifest.items:
        assert is_visible(
            load_sample(item.sample, default_registry()), item.type == "Global", small
        )


def test_the_two_modifications_differ(manifest):
    first, second = (
        item.sample.sha256 for item in manifest.items if item.type == "Modify"
    )
    assert first != second


def test_the_same_seed_gives_the_same_manifest_and_another_another(manifest, small):
    again = build_generated(1, small, default_registry())
    assert again == manifest and again.sha256 == manifest.sha256
    other = build_generated(1, small.model_copy(update={"seed": 4}), default_registry())
    assert other.sha256 != manifest.sha256


def test_what_is_written_is_read_back(manifest, manifest_file):
    assert read_bench_manifest(manifest_file) == manifest


def test_names_and_versions_do_not_make_another_benchmark(manifest):
    renamed = manifest.model_copy(update={"name": "x", "made_with": {}, "notes": {}})
    assert renamed.sha256 == manifest.sha256
    assert manifest.model_copy(update={"image_size": 64}).sha256 != manifest.sha256


def test_only_a_part_may_be_asked_for(manifest):
    assert [item.type for item in manifest.limited(1, 2).items] == ["Add", "Remove"]


def test_an_item_holds_the_truth_and_where_it_differs(manifest, manifest_file):
    record = next(item for item in manifest.items if item.type == "Remove")
    item = load_item(manifest, record, manifest_file.parent, default_registry())
    assert item.inputs == 2 and item.photos.count == 4
    difference = (item.truth - item.photos.images[0]).abs().amax(1)
    assert difference[item.masks == 0].max() < 0.01 and 0 < item.masks.mean() < 0.9
    assert torch.equal(item.cameras.c2w[0, 0], torch.eye(4)) and (item.depths > 0).all()


def test_a_global_edit_has_no_mask(manifest, manifest_file):
    record = next(item for item in manifest.items if item.type == "Global")
    assert (
        load_item(manifest, record, manifest_file.parent, default_registry()).masks
        is None
    )


def test_change_masks_reach_a_little_further_than_the_change():
    photos = torch.zeros(1, 3, 40, 40)
    truth = photos.clone()
    truth[:, 1, 20, 20] = 0.5
    masks = change_masks(photos, truth)
    assert masks[0, 19:22, 19:22].all() and masks.sum() == 9


def test_another_picture_than_the_manifests_is_noticed(manifest, manifest_file):
    record = manifest.items[0]
    changed = record.model_copy(
        update={"sample": record.sample.model_copy(update={"sha256": "0" * 64})}
    )
    with pytest.raises(InputError, match="not the manifest's"):
        load_item(manifest, changed, manifest_file.parent, default_registry())


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (lambda c: c.update(version=2), InputError, "reads version 1"),
        (lambda c: c.update(format="other"), InputError, "not a benchmark manifest"),
        (
            lambda c: c["items"].append(c["items"][0]),
            InputError,
            "two items are called",
        ),
        (
            lambda c: c["items"][0].update(scene="nowhere"),
            InputError,
            "not in the manifest",
        ),
        (lambda c: c["items"][0].update(type="Rotate"), SettingsError, "items.0.type"),
        (lambda c: c["items"][0].update(promt="x"), SettingsError, "promt"),
    ],
)
def test_a_broken_manifest_is_one_sentence(
    manifest_file, tmp_path, change, error, words
):
    content = json.loads(manifest_file.read_text())
    change(content)
    path = tmp_path / "bench.json"
    path.write_text(json.dumps(content))
    with pytest.raises(error, match=words):
        read_bench_manifest(path)


def test_a_manifest_is_written_whole_or_not_at_all(manifest, tmp_path):
    twice = manifest.model_copy(update={"items": (*manifest.items, manifest.items[0])})
    with pytest.raises(InputError):
        write_bench_manifest(tmp_path / "bench.json", twice)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"inputs": (0, -1)}, "uses frame -1, which its scene does not have"),
        ({"held_back": (-2,)}, "uses frame -2"),
        ({"inputs": (0, 1, 1)}, "uses a frame twice"),
        ({"inputs": (0, 5), "sample": None}, "uses frame 0, which"),
        ({"id": "../../escaped"}, "no plain file name"),
        ({"id": "/tmp/escaped"}, "no plain file name"),
        ({"id": "."}, "no plain file name"),
    ],
)
def test_items_that_lead_elsewhere_are_refused(manifest, tmp_path, change, expected):
    wrong = manifest.items[0].model_copy(update=change)
    content = manifest.model_copy(
        update={"items": (wrong, *manifest.items[1:])}
    ).model_dump(mode="json")
    (tmp_path / "m.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=expected):
        read_bench_manifest(tmp_path / "m.json")


def test_a_frame_that_a_generated_scene_does_not_have_is_named(manifest, manifest_file):
    record = manifest.items[0].model_copy(update={"inputs": (0, 99)})
    with pytest.raises(InputError, match="uses frame 99"):
        load_item(manifest, record, manifest_file.parent, default_registry())
