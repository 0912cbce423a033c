import pytest
import torch

from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import EditRequest, Views
from edit3r.loading.registry import build


def photos() -> Views:
    """Two views of one smooth picture, so that what differs between the results is the editor's
    doing.
    """
    ramp = torch.linspace(0.2, 0.8, 48)
    image = torch.stack(
        (ramp.expand(32, 48), ramp.flip(0).expand(32, 48), torch.full((32, 48), 0.5))
    )
    return Views(image.expand(1, 2, 3, 32, 48).clone(), torch.eye(3).expand(1, 2, 3, 3))


def edit(prompt: str = "turn it to bronze", seed: int = 1, **settings) -> torch.Tensor:
    return (
        build("editor", "mock-diffusion", **settings)
        .edit(photos(), EditRequest(prompt, seed))
        .images
    )


def change(**settings) -> float:
    return float((edit(**settings) - photos().images).abs().mean())


def views_differ(**settings) -> float:
    first, second = edit(**settings)[0]
    return float((first - second).abs().mean())


@pytest.mark.parametrize("other", [{"seed": 2}, {"prompt": "turn it to stone"}])
def test_seed_and_prompt_change_the_result(other):
    assert (edit(**other) - edit()).abs().mean() > 0.01


def test_disagreement_is_a_dial():
    amounts = [views_differ(disagreement=amount) for amount in (0.0, 0.25, 0.5, 1.0)]
    assert amounts[0] == 0 and amounts == sorted(amounts) and amounts[-1] > 0.05


def test_strength_0_returns_the_photos():
    assert torch.equal(edit(strength=0), photos().images)
    assert change(strength=0.3, disagreement=0) < change(strength=1.0, disagreement=0)


def test_few_steps_leave_noise():
    roughness = [
        edit(steps=steps, disagreement=0).diff(dim=-1).abs().mean()
        for steps in (2, 6, 20, 40)
    ]
    assert (
        roughness[0] > roughness[1] > roughness[2]
        and abs(roughness[2] - roughness[3]) < 0.01 * roughness[2]
    )


def test_progress_is_reported_for_each_step_of_each_view():
    events = []
    with collecting(Report(on_event=lambda *event: events.append(event))):
        edit(steps=5)
    assert [event[2:] for event in events if event[0] == "progress"] == [
        (done, 5) for done in range(6)
    ] * 2


def test_it_says_that_it_is_a_stand_in():
    with collecting(Report()) as report:
        edit()
    assert "stand-in" in report.warnings[0]
    assert "stand-in" in build("editor", "mock-diffusion").offer.component.summary


@pytest.mark.parametrize("height, width", [(1, 1), (1, 7), (5, 2)])
def test_tiny_pictures(height, width):
    views = Views(torch.rand(1, 1, 3, height, width), torch.eye(3).expand(1, 1, 3, 3))
    images = (
        build("editor", "mock-diffusion", disagreement=1)
        .edit(views, EditRequest("x"))
        .images
    )
    assert images.shape == views.images.shape and torch.isfinite(images).all()
