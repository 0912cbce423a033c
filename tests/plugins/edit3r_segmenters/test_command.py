"""`edit3r mask` shows what is selected, and leaves a run less to do."""

import pytest

from edit3r.cli.main import main
from edit3r.kit.cache import using
from edit3r.kit.photos.images import load_photos, packaged_pair
from edit3r.loading.registry import default_registry
from edit3r.running.geometry import default_matcher
from edit3r.running.job import JobInputs, job_from

pytestmark = pytest.mark.slow

SIZE = "160"


@pytest.fixture(scope="module")
def masks(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mask") / "masks"
    photos = map(str, packaged_pair()[0])
    flags = ["--point", "0.5,0.5", "--size", SIZE, "--out", str(folder), "--quiet"]
    assert main(["mask", *photos, *flags]) == 0
    return folder


def test_a_mask_for_each_photo_and_a_picture_are_written(masks):
    names = sorted(file.name for file in masks.glob("*.png"))
    assert len(names) == 3 and "preview.png" in names


def test_a_run_with_the_masks_does_not_look_for_geometry_again(masks):
    photos = tuple(map(str, packaged_pair()[0]))
    files = tuple(map(str, sorted(masks.glob("*_mask.png"))))
    job = job_from(JobInputs(photos=photos, mask=files), {"size": int(SIZE)})
    views = load_photos(photos, size=int(SIZE)).views
    with using(job.cache):
        default_matcher(default_registry()).match(views)
    assert "match" in job.cache.reused and not job.cache.computed
