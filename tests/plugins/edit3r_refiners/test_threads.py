"""The same scene is simplified and refined to the same bits for any number of threads."""

import pytest
import torch

import edit3r
from edit3r.kit.photos.images import load_views, packaged_pair


@pytest.mark.slow
def test_the_refined_scene_does_not_depend_on_the_number_of_threads():
    photos, cameras = packaged_pair()
    views = load_views(photos, cameras=cameras, size=96)
    before, scenes = torch.get_num_threads(), []
    for threads in (1, 2, 4, 4):
        torch.set_num_threads(threads)
        scenes.append(
            edit3r.run(views, editor="none", recon="classical", refine=3).gaussians
        )
    torch.set_num_threads(before)
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        assert all(
            torch.equal(getattr(scenes[0], name), getattr(scene, name))
            for scene in scenes[1:]
        ), name
