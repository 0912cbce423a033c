"""The same photos, edit and seed give the same scene for any number of threads."""

import pytest
import torch

import edit3r
from edit3r.kit.photos.images import load_views, packaged_pair
from edit3r.kit.reconstructing import WithMatcher
from edit3r.running import default_matcher


@pytest.mark.slow
@pytest.mark.parametrize(("size", "grid"), [(128, None), (64, (42, 42))])
def test_the_scene_does_not_depend_on_the_number_of_threads(size, grid):
    photos, cameras = packaged_pair()
    views = load_views(photos, cameras=cameras, size=size)
    edited = edit3r.Views(views.images.flip(2), views.intrinsics, views.names)
    matcher = default_matcher(edit3r.default_registry())
    reconstructor = WithMatcher(edit3r.build("reconstructor", "edit3r"), matcher)
    before, scenes = torch.get_num_threads(), []
    for threads in (1, 2, 4):
        torch.set_num_threads(threads)
        with torch.no_grad():
            scenes.append(reconstructor(edited, views, grid).gaussians)
    torch.set_num_threads(before)
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        first, *others = (getattr(scene, name) for scene in scenes)
        assert all(torch.equal(first, other) for other in others), name
