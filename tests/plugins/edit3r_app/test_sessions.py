"""What is read of a scene's photos: what the page is told of those that make no good scene."""

from concurrent.futures import Future
from dataclasses import replace

import pytest
from edit3r_app.sessions import Session

from edit3r.contract.types import Views
from edit3r.running.geometry import GeometryAnswer
from edit3r_testing import photograph
from edit3r_testing.scenes import true_geometry

VIEWS = replace(photograph(2, (48, 64)).views, names=("a", "b"))


def told(answer: "Future[GeometryAnswer]", views: Views = VIEWS) -> tuple[str, bool]:
    progress = Session(views, None, 0.0, None, geometry=answer).progress(1.0)
    return progress.trouble, progress.placed


def answered(geometry, problem="") -> "Future[GeometryAnswer]":
    future: Future[GeometryAnswer] = Future()
    future.set_result(GeometryAnswer(geometry, problem))
    return future


def failed() -> "Future[GeometryAnswer]":
    future: Future[GeometryAnswer] = Future()
    future.set_exception(RuntimeError("out of memory"))
    return future


@pytest.mark.parametrize(
    ("answer", "trouble"),
    [(failed(), "out of memory"), (answered(None, "too dark"), "too dark")],
)
def test_photos_without_any_geometry_make_no_scene(answer, trouble):
    assert told(answer) == (trouble, False)


def test_a_photo_that_cannot_be_placed_is_named_and_the_others_make_a_scene():
    geometry = true_geometry(VIEWS)
    assert told(answered(geometry)) == ("", True)
    geometry.registered[0, 1] = False
    trouble, placed = told(answered(geometry))
    assert trouble.startswith("b: shows too little") and placed


def test_nothing_is_said_before_it_is_known():
    assert told(Future()) == ("", True)
