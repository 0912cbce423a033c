from types import SimpleNamespace

import pytest
import torch
from edit3r_training.losses import (
    CenterLoss,
    ClipLoss,
    GeometryLoss,
    MseLoss,
    PointDistillationLoss,
    chamfer_l1,
    pairwise_chamfer,
)

import edit3r
from edit3r.contract.errors import MissingDependencyError, SettingsError
from edit3r.contract.interfaces import LossInputs
from edit3r.contract.types import Gaussians
from edit3r_testing import CONTRACTS, Contract, claims, contract_for


def _gaussians(means: torch.Tensor, views: list[int]) -> Gaussians:
    count = means.shape[1]
    ones = torch.ones(1, count, 4)
    return Gaussians(
        means,
        ones[..., :3],
        ones,
        ones[..., 0],
        torch.zeros(1, count, 1, 3),
        torch.tensor(views),
    )


def test_mse_is_blind_to_detail_within_a_cell_and_sees_a_shift_of_colour():
    target = torch.full((1, 1, 3, 8, 8), 0.5)
    detail = target.clone()
    detail[..., ::2] += 0.2
    detail[..., 1::2] -= 0.2
    loss = MseLoss(MseLoss.Settings(cell=4))
    assert float(loss(LossInputs(detail, target))) < 1e-12
    assert float(loss(LossInputs(target + 0.1, target))) == pytest.approx(0.01)


@pytest.mark.parametrize(("beta", "value"), [(0.1, 0.45), (1.0, 0.125), (4.0, 1 / 32)])
def test_beta_is_the_distance_at_which_the_square_of_centres_turns_linear(beta, value):
    """Below beta d^2 / (2 beta), above it d - beta / 2; here d = 0.5."""
    reference = _gaussians(torch.zeros(1, 4, 3), [0, 0, 1, 1])
    moved = _gaussians(torch.full((1, 4, 3), 0.5), [0, 0, 1, 1])
    loss = CenterLoss(CenterLoss.Settings(beta=beta))
    inputs = LossInputs(gaussians=moved, reference=reference)
    assert float(loss(inputs)) == pytest.approx(value)


def test_points_are_compared_in_each_cloud_s_own_unit_and_outliers_left_out():
    torch.manual_seed(0)
    reference = torch.rand(1, 100, 3) + 1

    def loss(means, **settings):
        predicted, frozen = (_gaussians(one, [0] * 100) for one in (means, reference))
        asked = PointDistillationLoss.Settings(**settings)
        return PointDistillationLoss(asked)(
            LossInputs(gaussians=predicted, reference=frozen)
        )

    assert loss(7 * reference) == pytest.approx(0, abs=1e-6)
    farthest = reference.norm(dim=-1).argmax()
    moved = reference.clone()
    moved[0, farthest] += 0.5
    assert loss(moved, outliers=0) > 1.5 * loss(moved, outliers=0.02) > 0
    turned = reference[..., [1, 2, 0]]
    unit = reference.norm(dim=-1).mean()
    assert loss(turned, outliers=0) == pytest.approx(
        float((turned - reference).norm(dim=-1).mean() / unit)
    )


@pytest.mark.parametrize(
    "means",
    [
        torch.tensor([[[0.0, 0, 2]]]),
        torch.zeros(1, 5, 3),
        torch.zeros(1, 1, 3),
        torch.full((1, 4, 3), 1e-30),
    ],
    ids=["one", "all at the origin", "one at the origin", "too near for a length"],
)
def test_points_of_no_size_have_a_finite_distance_and_gradient(means):
    reference = _gaussians(means, [0] * means.shape[1])
    for start in (means, means + 1):
        moved = start.clone().requires_grad_()
        ours = _gaussians(moved, [0] * means.shape[1])
        value = PointDistillationLoss(PointDistillationLoss.Settings())(
            LossInputs(gaussians=ours, reference=reference)
        )
        value.backward()
        assert value.isfinite() and moved.grad.isfinite().all()
        assert start is not means or float(value) == 0


def test_as_many_points_are_left_out_at_either_end():
    """Of ten one each: the third of the others, that is off by 3, counts for an eighth."""
    z = torch.arange(1.0, 11)[None, :, None] * torch.tensor([0.0, 0, 1])
    moved = z.clone()
    moved[0, [0, 9], 0] = 100
    moved[0, 0, 2], moved[0, 9, 2] = 0, 0
    loss = PointDistillationLoss(PointDistillationLoss.Settings(outliers=0.1))
    reference, ours = (_gaussians(means, [0] * 10) for means in (z, moved))
    value = float(loss(LossInputs(gaussians=ours, reference=reference)))
    units = [float(m.norm(dim=-1).mean()) for m in (z, moved)]
    expected = [abs(k / units[0] - k / units[1]) for k in range(2, 10)]
    assert value == pytest.approx(sum(expected) / 8, rel=1e-5)


def test_chamfer_of_two_points_is_twice_their_l1_distance():
    a, b = torch.zeros(1, 1, 3), torch.tensor([[[1.0, 2.0, 3.0]]])
    assert float(chamfer_l1(a, b)) == pytest.approx(12)


def test_chamfer_counts_the_points_of_both_sets():
    """The one point of `a` is also in `b`; those of `b` are 0 and 4 from it, 2 in the mean."""
    a, b = torch.zeros(1, 1, 3), torch.tensor([[[0.0, 0, 0], [4, 0, 0]]])
    assert float(chamfer_l1(a, b)) == float(chamfer_l1(b, a)) == 2


def test_geometry_divides_by_views_times_views_less_one():
    """Three views at 0, 1 and 3 on a line: pairs 1, 2 and 3 apart, Chamfer 2, 4 and 6, sum 12,
    divided by 6.
    """
    means = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [3, 0, 0]]])
    value = pairwise_chamfer(means, [torch.tensor([i]) for i in range(3)])
    assert float(value) == pytest.approx(2)


def test_geometry_of_the_reference_itself_is_worth_nothing():
    """Views do not show quite the same surface; that distance is taken off."""
    loss = GeometryLoss(GeometryLoss.Settings(samples=8))
    means = torch.tensor([[[0.0, 0, 0], [1, 1.5, 0], [0, 3, 0], [4, 0, 1]]])
    truth = _gaussians(means, [0, 0, 1, 1])
    assert float(loss(LossInputs(gaussians=truth))) > 1
    assert float(loss(LossInputs(gaussians=truth, reference=truth))) == 0


def test_geometry_has_the_same_gradient_with_and_without_a_reference():
    loss = GeometryLoss(GeometryLoss.Settings(samples=8))
    gradients = []
    for reference in (None, _gaussians(torch.zeros(1, 4, 3), [0, 0, 1, 1])):
        means = torch.tensor(
            [[[0.0, 0, 0], [1, 1.5, 0], [0, 3, 0], [4, 0, 1]]], requires_grad=True
        )
        loss(
            LossInputs(gaussians=_gaussians(means, [0, 0, 1, 1]), reference=reference)
        ).backward()
        gradients.append(means.grad)
    assert torch.equal(*gradients)


def test_a_step_without_a_reference_is_an_error_that_says_so():
    loss = CenterLoss(CenterLoss.Settings())
    with pytest.raises(SettingsError, match="no reference"):
        loss(LossInputs(gaussians=_gaussians(torch.zeros(1, 1, 3), [0])))


def test_clip_is_given_images_normalised_as_it_was_trained(monkeypatch):
    seen = []

    class Clip:
        config = SimpleNamespace(image_size=8)

        def to(self, device):
            return self

        def __call__(self, pixel_values):
            seen.append(pixel_values)
            return SimpleNamespace(image_embeds=pixel_values.flatten(1))

    monkeypatch.setattr("edit3r_training.losses._frozen_clip", lambda name: Clip())
    black, white = torch.zeros(1, 1, 3, 8, 8), torch.ones(1, 1, 3, 8, 8)
    ClipLoss(ClipLoss.Settings())(LossInputs(rendered=black, target=white))
    # As published with CLIP: openai/CLIP, clip/clip.py.
    mean = torch.tensor([0.48145466, 0.4578275, 0.40821073])
    deviation = torch.tensor([0.26862954, 0.26130258, 0.27577711])
    for given, colour in zip(seen, (0, 1)):
        expected = (colour - mean) / deviation
        assert torch.allclose(given.mean((0, 2, 3)), expected, atol=1e-5)


def test_clip_compares_each_image_with_its_own_target(monkeypatch):
    embeddings = iter(
        torch.tensor([[[1.0, 2, 0], [0, 1, 1]], [[3.0, 1, 1], [0, 2, 2]]])
    )
    loss = ClipLoss.__new__(ClipLoss)
    monkeypatch.setattr(loss, "_embed", lambda images: next(embeddings))
    picture = torch.rand(1, 2, 3, 8, 8)
    value = loss(LossInputs(rendered=picture, target=picture))
    first = 5 / (5 * 11) ** 0.5  # cosine of the first pair; the second is parallel
    assert torch.isclose(value, torch.tensor(1 - (first + 1) / 2))


@pytest.fixture
def squared(monkeypatch):
    """In the place of LPIPS, whose package may be missing; it has tests of its own."""
    monkeypatch.setattr("edit3r.loading.registry._installed", lambda module: True)
    distance = lambda images, photos: (images - photos).square().mean((1, 2, 3))  # noqa: E731
    monkeypatch.setattr("edit3r_training.losses.lpips_distances", distance)


def test_lpips_is_the_mean_over_all_images(squared):
    rendered, target = torch.rand(
        2, 2, 2, 3, 8, 8, generator=torch.Generator().manual_seed(0)
    )
    value = edit3r.build("loss", "lpips")(LossInputs(rendered=rendered, target=target))
    assert torch.isclose(value, (rendered - target).square().mean())


@pytest.mark.parametrize(
    "claim", sorted({*claims(CONTRACTS["loss"])} - {*claims(Contract)})
)
def test_lpips_keeps_the_contract(squared, claim):
    getattr(contract_for("loss", "lpips")(), claim)()


def test_without_the_package_the_install_command_is_named(monkeypatch):
    monkeypatch.setattr(
        "edit3r.loading.registry._installed", lambda module: module != "stlpips_pytorch"
    )
    with pytest.raises(
        MissingDependencyError, match=r'pip install "edit3r\[stlpips\]"'
    ):
        edit3r.build("loss", "lpips")


def test_centres_are_drawn_at_random_from_all_of_a_view():
    """Not the first ones: those of an image are one edge of it."""
    loss = GeometryLoss(GeometryLoss.Settings(samples=20))
    views = torch.arange(2).repeat_interleave(100)
    torch.manual_seed(0)
    draws = [loss._sample(views) for _ in range(3)]
    for first, second in draws:
        assert len(first) == len(second) == 20 == len(set(first.tolist()))
        assert bool((first < 100).all()) and bool((second >= 100).all())
        assert int(first.max()) > 60 and int(second.max()) > 160
    assert {*draws[0][0].tolist()} != {*draws[1][0].tolist()}
