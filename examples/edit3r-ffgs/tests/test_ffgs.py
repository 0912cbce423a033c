"""edit3r's contract of a reconstructor on a tiny random AnySplat; run where ffgs and this package
are installed.
"""

import pytest
import torch

import edit3r
from edit3r.contract.errors import MissingDependencyError
from edit3r.kit.geometry.cameras import invert_rigid, project
from edit3r_testing import ReconstructorContract
from edit3r_testing.scenes import photograph

ffgs = pytest.importorskip(
    "ffgs", reason="pip install ffgs, and torchvision for your torch"
)
anysplat = pytest.importorskip("ffgs.models.anysplat")


@pytest.fixture(scope="module", autouse=True)
def saved(tmp_path_factory):
    """A folder with a tiny AnySplat in ffgs' own layout."""
    torch.manual_seed(0)
    network = anysplat.AnySplat(
        embed_dim=64,
        img_size=56,
        intermediate_layer_idx=[0, 1, 2, 3],
        aggregator={"depth": 4, "num_heads": 4, "patch_embed": "conv"},
        camera_head={"trunk_depth": 1, "num_heads": 4},
        depth_head={"features": 16, "out_channels": [16, 16, 16, 16]},
        gs_head={"out_channels": [16, 16, 16, 16]},
    )
    processor = anysplat.AnySplatProcessor(
        anysplat.AnySplatProcessorConfig(image_shape=[56, 56])
    )
    folder = tmp_path_factory.mktemp("anysplat")
    ffgs.GSPipeline(network, processor).save_pretrained(folder)
    TestFfgsKeepsTheContract.settings = {"model": str(folder)}
    return folder


class TestFfgsKeepsTheContract(ReconstructorContract):
    component = "ffgs"
    min_views = 2


def test_what_a_view_sees_stays_where_the_network_put_it(saved):
    """Pixels of the Gaussians in view 1, by edit3r's cameras, against ffgs' own cameras on the cut
    it was given.
    """
    reconstructor = edit3r.build("reconstructor", "ffgs", model=str(saved))
    views = photograph(2, (96, 128)).views
    own = reconstructor.pipeline(ffgs.Views(views.images[0]))
    result = reconstructor(views)
    expected, _ = project(
        own.gaussians.means[0], own.cameras.normalized_k[0, 1], own.cameras.c2w[0, 1]
    )
    found, depth = project(
        result.gaussians.means[0],
        result.cameras.intrinsics[0, 1],
        result.cameras.c2w[0, 1],
    )
    # The cut is the middle square of a photo of 4:3.
    on_the_cut = (found - 0.5) * torch.tensor([4 / 3, 1.0]) + 0.5
    near = depth.abs() > 0.05
    assert torch.allclose(on_the_cut[near], expected[near], rtol=1e-3, atol=1e-2)
    assert torch.equal(result.cameras.c2w[0, 0], torch.eye(4))
    assert torch.allclose(
        invert_rigid(result.cameras.c2w) @ result.cameras.c2w, torch.eye(4), atol=1e-5
    )


def test_without_weights_it_says_how_to_get_them(monkeypatch, tmp_path):
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path))
    monkeypatch.setenv("HF_HOME", str(tmp_path))
    with pytest.raises(
        MissingDependencyError,
        match=r"edit3r weights get anysplat .*commercial use: no",
    ):
        edit3r.build("reconstructor", "ffgs")
