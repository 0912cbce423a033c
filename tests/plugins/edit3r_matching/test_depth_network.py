import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from edit3r_matching.cameras import CalibratedImage, Pose, project, rays_through
from edit3r_matching.depth_network import (
    STRIDE,
    DepthNetwork,
    at_pixels,
    cell_costs,
    cell_grids,
    load_depth_network,
    plane_log_probabilities,
)
from edit3r_matching.depth_samples import Wrongness, batch_of, on_planes
from edit3r_matching.depth_trainer import DepthRecipe, DepthTrainer
from edit3r_matching.plane_sweep import Neighbour, matching_cost
from edit3r_matching.semi_global import aggregate
from edit3r_training.job import prepare

from edit3r.config import find_config, read_yaml
from edit3r.errors import InputError, SettingsError
from edit3r.interfaces import TrainingJob
from edit3r.registry import build, default_registry

SIDEWAYS = Pose(np.eye(3), np.array([-0.5, 0, 0]))
PLANES = np.linspace(0.2, 1.0, 12)
DATA = {"image_size": 32, "textures": 8, "scenes": 4, "targets": 0, "context": 3}
CLEAN = Wrongness(matches=0, focal=0, exposure=0, noise=0)


def image(seed, size=(48, 64)):
    pixels = np.random.default_rng(seed).random((*size, 3)).astype(np.float32)
    return CalibratedImage(pixels, np.array([[60.0, 0, size[1] / 2], [0, 60, size[0] / 2], [0, 0, 1]]))


def answer(network, reference, neighbours):
    cost = matching_cost(reference, neighbours, PLANES)
    total = aggregate(cost, reference.grey)
    return plane_log_probabilities(network, reference, neighbours, PLANES, cost, total), cell_costs(cost, total)


@pytest.fixture
def network():
    torch.manual_seed(0)
    return DepthNetwork().eval()


@pytest.fixture
def learnt(network):
    """One whose last layer is not 0 any more."""
    torch.nn.init.normal_(network.regulariser.leave.weight, std=0.05)
    return network


@pytest.fixture
def samples():
    data = build("dataset", "procedural", **DATA)
    return [data[0], data[1]]


def test_an_untrained_network_says_what_semi_global_matching_says(network):
    logs, cells = answer(network, image(0), [Neighbour(image(1), SIDEWAYS)])
    assert np.allclose(np.exp(logs).sum(0), 1, atol=1e-5)
    assert np.array_equal(logs.argmax(0), cells[2].argmin(0))


def test_the_order_of_the_neighbours_does_not_matter(learnt):
    others = [Neighbour(image(1), SIDEWAYS), Neighbour(image(2, (40, 72)), Pose(np.eye(3), np.array([0.3, 0.1, 0])))]
    one, two = (answer(learnt, image(0), order)[0] for order in (others, others[::-1]))
    assert np.allclose(one, two, atol=1e-4)
    assert not np.allclose(one, answer(learnt, image(0), others[:1])[0], atol=1e-2)


def test_sides_need_not_be_multiples_of_anything(learnt):
    reference = image(0, (45, 61))
    logs, _ = answer(learnt, reference, [Neighbour(image(1, (45, 61)), SIDEWAYS)])
    assert logs.shape == (len(PLANES), 12, 16)
    assert np.isfinite(logs).all()


def test_pixels_get_the_answer_of_their_cells(learnt):
    reference, neighbours = image(0), [Neighbour(image(1), SIDEWAYS)]
    cells, _ = answer(learnt, reference, neighbours)
    logs = at_pixels(cells, reference.size)
    centre = logs[17:19, 25:27].mean((0, 1))  # around the centre of cell (4, 6)
    assert logs.shape == (*reference.size, len(PLANES))
    assert np.allclose(centre, cells[:, 4, 6], atol=0.2 * np.ptp(cells[:, 4, 6]))


def test_grids_are_where_the_cells_appear():
    reference, other = image(0), image(1)
    pose = Pose(SIDEWAYS.rotation, np.array([-0.5, 0.2, 0.1]))
    grids = cell_grids(reference, [Neighbour(other, pose)], PLANES)
    rays = rays_through(np.array([5.5, 3.5]) * STRIDE, reference.intrinsics)
    expected = project(pose.apply(rays / PLANES[4]), other.intrinsics)
    assert np.allclose((grids[0, 4, 3, 5] + 1) / 2 * (64, 48), expected, atol=1e-3)


def test_shares_on_planes_add_up_and_leave_out_what_is_beyond():
    inverse = np.full((4, 8), 0.5)
    inverse[:, 4:] = 3.0
    inverse[0, 0] = np.nan
    shares = on_planes(inverse, np.array([0.0, 0.4, 0.8]))
    assert shares[:, 0, 1].sum() == 0
    assert np.allclose(shares[:, 0, 0], np.array([0, 0.75, 0.25]) * 15 / 16)


def test_without_errors_the_right_depth_is_the_true_one(samples):
    batch = batch_of(samples[:1], np.random.default_rng(0), CLEAN, (16, 16))
    true = 1 / samples[0].context_depths.numpy()
    assert min(np.nanmax(np.abs(batch.depth[0].numpy() / one - 1)) for one in true) < 1e-3


def test_with_wrong_poses_the_right_depth_is_that_of_the_true_match(samples):
    """Cells look the same in the neighbour at the right plane: better than at the planes beside it."""
    how = replace(CLEAN, matches=4.0)
    rng = np.random.default_rng(3)
    batch = batch_of([build("dataset", "procedural", **{**DATA, "image_size": 64})[2]], rng, how, (32, 32))
    cost, truth = batch.classical[0, 0], batch.truth[0]
    right = (cost * truth).sum() / truth.sum()
    assert right < 0.8 * min((cost.roll(shift, 0) * truth).sum() / truth.sum() for shift in (-4, 4))


@pytest.fixture
def job(tmp_path):
    data = build("dataset", "procedural", **DATA)
    reconstructor = build("reconstructor", "classical", matcher={"name": "classical", "depth_weights": "untrained"})
    torch.manual_seed(0)
    reconstructor.parts["matcher"].depth_network = DepthNetwork()
    return TrainingJob(reconstructor, build("rasterizer", "torch"), data, data, {}, tmp_path / "run")


def trainer(**settings) -> DepthTrainer:
    return build(
        "trainer", "depth-network", **{"warmup": 1, "log_every": 1, "held_out": 2, "planes": (12, 16), **settings}
    )


def test_training_lowers_the_loss_and_leaves_weights_that_load(job):
    best = trainer(steps=12, validate_every=12, average=0.5, lr=5e-3).train(job)
    lines = [json.loads(line) for line in (job.out / "log.jsonl").read_text().splitlines()]
    losses = [line["loss"] for line in lines if line["kind"] == "train"]
    assert sum(losses[-4:]) < 0.9 * sum(losses[:4])
    loaded = load_depth_network(str(best / "weights.safetensors"))
    assert not torch.equal(loaded.regulariser.leave.weight, torch.zeros_like(loaded.regulariser.leave.weight))
    assert {"within_3", "classical_within_3"} <= set(lines[-1])


def test_a_resumed_training_gives_the_weights_of_a_straight_one(job, tmp_path, monkeypatch):
    network = job.reconstructor.parts["matcher"].depth_network
    start = {name: value.clone() for name, value in network.state_dict().items()}
    trainer(steps=4, checkpoint_every=2).train(replace(job, out=tmp_path / "straight"))
    expected = {name: value.clone() for name, value in network.state_dict().items()}
    network.load_state_dict(start)
    halves, loss = replace(job, out=tmp_path / "halves"), DepthRecipe.loss

    def interrupted(recipe, step, processes):
        if step == 2:
            raise RuntimeError("power failure")
        return loss(recipe, step, processes)

    with monkeypatch.context() as patch, pytest.raises(RuntimeError):
        patch.setattr(DepthRecipe, "loss", interrupted)
        trainer(steps=4, checkpoint_every=2).train(halves)
    network.load_state_dict(start)
    trainer(steps=4, checkpoint_every=2).train(replace(halves, resume=True))
    assert all(torch.equal(value, expected[name]) for name, value in network.state_dict().items())


def test_a_matcher_without_the_network_is_refused(job):
    with pytest.raises(SettingsError, match="depth_weights"):
        trainer(steps=1).train(replace(job, reconstructor=build("reconstructor", "classical")))


def test_weights_that_are_not_there_are_refused():
    with pytest.raises(InputError, match="no such weights"):
        build("matcher", "classical", depth_weights="nowhere.safetensors")


def test_the_shipped_recipe_can_be_built(tmp_path):
    values = read_yaml(find_config("training/depth"))
    values["reconstructor"]["matcher"]["depth_weights"] = "untrained"
    built, job = prepare({**values, "out": str(tmp_path / "run")}, default_registry())
    assert isinstance(built, DepthTrainer)
    assert job.train_data.settings.seed != job.validation_data.settings.seed
