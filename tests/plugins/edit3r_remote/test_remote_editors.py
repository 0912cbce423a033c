"""Both remote editors against a fake service that answers well, late, wrongly or not at all."""

from dataclasses import replace

import pytest
import torch

import edit3r
from edit3r.contract.errors import (
    Edit3rError,
    MissingDependencyError,
    PromptError,
    RunError,
)
from edit3r.contract.reporting import Report, collecting

ASK = edit3r.EditRequest("paint it red", seed=3)
SECRET = "sk-very-secret"


@pytest.fixture(autouse=True)
def small_frames(editor_name, monkeypatch):
    """Pictures of an eighth of the services' sizes, for speed; their own sizes have tests of their
    own.
    """
    if editor_name == "gpt-image":
        monkeypatch.setattr(
            "edit3r_remote.gpt_image.SIZES", ((128, 128), (128, 192), (192, 128))
        )
    else:
        monkeypatch.setattr(
            "edit3r_remote.gemini_image.SHAPES", {(128, 128): "1:1", (108, 148): "4:3"}
        )


def test_views_come_back_edited_in_place_and_at_their_size(build, two_views):
    edited = build().edit(two_views, ASK)
    assert edited.images.shape == two_views.images.shape
    assert torch.allclose(edited.images, 1 - two_views.images, atol=0.02)


def test_the_prompt_is_sent_and_the_key_only_as_a_header(build, fake, two_views):
    build().edit(two_views, ASK)
    assert [request["prompt"] for request in fake.requests] == [b"paint it red"] * 2
    for request in fake.requests:
        assert any(SECRET in value for value in request["headers"].values())
        assert SECRET not in request["path"] and SECRET.encode() not in request["body"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "trouble", ["status:429", "status:500", "status:503", "truncated"]
)
def test_passing_trouble_is_retried(build, fake, two_views, trouble):
    fake.script.extend([trouble, trouble, "ok", "ok"])
    edited = build().edit(two_views, ASK)
    assert torch.allclose(edited.images, 1 - two_views.images, atol=0.02)
    assert len(fake.requests) == 4


@pytest.mark.slow
def test_an_answer_that_is_late_is_asked_for_again(build, fake, two_views):
    fake.script.extend(["slow:1.5", "ok", "ok"])
    build(timeout_s=0.6).edit(two_views, ASK)
    assert len(fake.requests) == 3


@pytest.mark.parametrize(
    ("trouble", "error", "says"),
    [
        (
            "status:429",
            RunError,
            r"rate limit .*after 2 tries for left\.png.*editor\.concurrent",
        ),
        ("status:500", RunError, r"failed on left\.png with status 500"),
        ("status:404", RunError, "status 404"),
        ("status:401", MissingDependencyError, "does not accept the key in "),
        ("garbage", RunError, "not an image.*this is no picture.*kept as"),
        ("wrong-shape", RunError, "another shape.*kept as"),
        ("refusal", PromptError, r"I will not paint that\."),
        ("half-json", RunError, r"no usable answer for left\.png"),
    ],
)
def test_lasting_trouble_is_one_sentence_without_the_key(
    build, fake, two_views, trouble, error, says
):
    fake.script.extend([trouble] * 4)
    with pytest.raises(error, match=says) as caught:
        build(attempts=2).edit(two_views, ASK)
    assert SECRET not in str(caught.value)
    # nothing for --debug to print either
    assert caught.value.__cause__ is None and caught.value.__suppress_context__


@pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
def test_neither_key_nor_photo_follows_to_another_host(
    build, fake, elsewhere, two_views, status
):
    fake.script.extend([f"elsewhere:{status} {elsewhere.url}"] * 2)
    with pytest.raises(
        RunError, match=r"redirects elsewhere, which is not followed.*editor\.base_url"
    ):
        build(attempts=1).edit(two_views, ASK)
    assert len(fake.requests) == 2 and not elsewhere.requests


def test_attempts_are_the_tries_for_each_photo(build, fake, two_views):
    fake.script.extend(["status:500"] * 8)
    with pytest.raises(RunError):
        build(attempts=2).edit(two_views, ASK)
    assert len(fake.requests) == 2 * 2


def test_a_key_sent_back_as_the_picture_is_neither_shown_nor_kept(
    build, fake, two_views, tmp_path
):
    fake.script.extend(["key"] * 4)
    with pytest.raises(RunError, match=r"not an image .*ab \*\*\*") as caught:
        build(attempts=1).edit(two_views, ASK)
    assert "sk-" not in str(caught.value)
    kept = list((tmp_path / "cache").iterdir())
    assert kept and not any(b"sk-" in path.read_bytes() for path in kept)


def test_a_picture_of_gigapixels_is_named_before_it_is_decoded(build, fake, two_views):
    fake.script.extend(["gigapixels"] * 4)
    with pytest.raises(
        RunError, match=r"the answer for left\.png (has|is).* far too many"
    ):
        build(attempts=1).edit(two_views, ASK)


@pytest.mark.slow
@pytest.mark.parametrize(
    "trouble", ["usage:null", "usage:-5", "no-usage", "usage:true"]
)
def test_a_bill_of_wrong_types_never_costs_the_picture(build, fake, two_views, trouble):
    fake.script.extend([trouble] * 2)
    for _ in range(2):  # the second time from the cache
        with collecting(Report()) as report:
            edited = build(attempts=1).edit(two_views, ASK)
        assert torch.allclose(edited.images, 1 - two_views.images, atol=0.02)
        assert report.notes["editor.cost_usd"] >= 0
    assert len(fake.requests) == 2


def test_an_answer_that_cannot_be_kept_is_used(build, fake, two_views, tmp_path):
    (tmp_path / "file").touch()
    with collecting(Report()) as report:
        edited = build(cache=str(tmp_path / "file")).edit(two_views, ASK)
    assert torch.allclose(edited.images, 1 - two_views.images, atol=0.02)
    assert any(
        "could not be saved in editor.cache" in warning for warning in report.warnings
    )


def test_a_service_that_is_not_there_is_one_sentence(build, fake, two_views):
    fake.server.shutdown()
    fake.server.server_close()
    with pytest.raises(Edit3rError, match=r"no usable answer for left\.png"):
        build(attempts=1).edit(two_views, ASK)


def test_an_answer_of_another_size_and_the_same_shape_is_scaled_and_said(
    build, fake, two_views
):
    fake.script.append("wrong-size")
    report = Report()
    with collecting(report):
        edited = build().edit(two_views, ASK)
    assert torch.allclose(edited.images, 1 - two_views.images, atol=0.02)
    assert (
        len(report.warnings) == 1
        and "left.png" in report.warnings[0]
        and "was scaled" in report.warnings[0]
    )


def test_a_broken_run_goes_on_without_paying_twice(build, fake, two_views):
    fake.script.extend(["ok", "refusal"])
    with pytest.raises(
        PromptError,
        match=r"1 of 2 views have their answer in .* will not be charged again",
    ):
        build().edit(two_views, ASK)
    report = Report()
    with collecting(report):
        edited = build().edit(two_views, ASK)
    assert len(fake.requests) == 3
    assert torch.allclose(edited.images, 1 - two_views.images, atol=0.02)
    left, right = report.notes["editor.views"]
    assert left["from_cache"] and left["cost_usd"] == 0 and left["seconds"] == 0
    assert not right["from_cache"] and right["cost_usd"] > 0 and right["seconds"] > 0


@pytest.mark.slow
def test_views_already_under_way_when_one_fails_are_kept(build, fake, two_views):
    fake.script.extend(["refusal", "slow:0.3"])
    with pytest.raises(PromptError, match="1 of 2 views"):
        build(concurrent=2).edit(two_views, ASK)
    build().edit(two_views, ASK)
    assert len(fake.requests) == 3


@pytest.mark.slow
def test_only_an_equal_request_is_answered_from_the_cache(build, fake, two_views):
    first = build().edit(two_views, ASK).images
    assert (
        torch.equal(build().edit(two_views, ASK).images, first)
        and len(fake.requests) == 2
    )
    changes = [
        lambda: build().edit(two_views, replace(ASK, prompt="paint it blue")),
        lambda: build().edit(two_views, replace(ASK, seed=4)),
        lambda: build().edit(replace(two_views, images=1 - two_views.images), ASK),
        lambda: build(model="another").edit(two_views, ASK),
    ]
    for done, change in enumerate(changes, start=2):
        change()
        assert len(fake.requests) == 2 * done


def test_without_a_cache_every_run_asks(build, fake, two_views):
    for _ in range(2):
        build(cache="").edit(two_views, ASK)
    assert len(fake.requests) == 4


@pytest.mark.slow
def test_views_are_sent_together_within_the_limit(build, fake, two_views):
    four = two_views.select([0, 1, 0, 1])
    four = replace(
        four, images=four.images * torch.linspace(0.5, 1, 4)[None, :, None, None, None]
    )
    fake.script.extend(["slow:0.4"] * 4)
    build(concurrent=2).edit(four, ASK)
    assert fake.busiest == 2


def test_cost_tokens_and_seconds_are_noted_per_view(build, two_views):
    report = Report()
    with collecting(report):
        build(input_price=10.0, output_price=40.0).edit(two_views, ASK)
    bills = report.notes["editor.views"]
    assert [bill["view"] for bill in bills] == ["left.png", "right.png"]
    assert all(
        bill["input_tokens"] == 100 and bill["output_tokens"] == 200 for bill in bills
    )
    assert all(
        bill["cost_usd"] == pytest.approx((100 * 10 + 200 * 40) / 1e6) for bill in bills
    )
    assert report.notes["editor.cost_usd"] == pytest.approx(0.018)
    assert SECRET not in str(report.notes) and "seed" in report.notes["editor.seed"]


def test_a_view_with_nothing_to_change_is_not_sent(build, fake, two_views):
    masks = torch.zeros(1, 2, 24, 32)
    masks[:, 1, :, 16:] = 1
    edited = build().edit(two_views, replace(ASK, masks=masks))
    assert len(fake.requests) == 1
    assert torch.equal(edited.images[:, 0], two_views.images[:, 0])


def test_an_empty_instruction_is_refused_before_anything_is_sent(
    build, fake, two_views
):
    with pytest.raises(PromptError, match="--prompt"):
        build().edit(two_views, edit3r.EditRequest(" "))
    assert not fake.requests


@pytest.mark.parametrize("value", [None, "  "])
def test_a_missing_key_names_the_variable(build, two_views, monkeypatch, value):
    for name in ("OPENAI_API_KEY", "GEMINI_API_KEY", "GOOGLE_API_KEY"):
        monkeypatch.delenv(name, raising=False)
        if value is not None:
            monkeypatch.setenv(name, value)
    with pytest.raises(
        MissingDependencyError, match=r"environment variable (OPENAI|GEMINI)_API_KEY"
    ):
        build().edit(two_views, ASK)
