"""Contract of a selector."""

from collections.abc import Mapping
from typing import Any

import torch

from edit3r.contract.errors import InputError, PluginError
from edit3r.contract.interfaces import Selected, Selection, Selector
from edit3r.kit import asking
from edit3r.kit.geometry.warping import SAME_SURFACE, shared_surface, warp
from edit3r_testing.contract import Contract, ContractViolation
from edit3r_testing.scenes import Photographed, true_geometry

SHARED = 0.5  # least overlap of a carried mask with where its surface is seen
NEVER_HEARD = "qwertzblorf"


class SelectorContract(Contract):
    """Marks are obeyed or refused, on the photo that they lie on and on all others."""

    kind = "selector"
    subject: Selector
    image_size = (72, 96)

    def select(
        self, selection: Selection, what: str, geometry: bool = True
    ) -> Selected | None:
        """What is selected on three photos; None where the selection is refused."""
        views = self.scene(3).views
        known = true_geometry(views) if geometry else None
        try:
            return asking.select(self.subject, views, selection, known)
        except InputError as error:
            self.require(str(error), f"{what} was refused without a word; say why.")
            return None
        except PluginError as error:
            raise ContractViolation(str(error)) from error

    def clicked(self, geometry: bool = True, **more: Any) -> Selected:
        """What a click on the second ball selects."""
        selection = Selection(positive=((0, *self._centre(1)),), **more)
        found = self.select(selection, "a click", geometry)
        self.require(found is not None, "a click was refused; it must be obeyed.")
        return found

    def test_a_click_is_obeyed_with_geometry_and_without(self) -> None:
        """Also one that says what is not meant."""
        for geometry in (True, False):
            found = self.clicked(geometry, negative=((0, *self._centre(0)),))
            self._require_in(found, self._centre(1), wanted=True)
            self._require_in(found, self._centre(0), wanted=False)

    def test_it_says_how_it_found_the_thing_on_each_photo(self) -> None:
        """One word for each; "not found" where the mask is empty, and nowhere else."""
        found = self.clicked()
        empty = [not bool((mask > 0.5).any()) for mask in found.masks]
        self.require(
            [how == "not found" for how in found.how] == empty,
            f'how is {found.how}; say "not found" where a mask is empty, and only there.',
        )

    def test_geometry_carries_the_thing_to_other_photos(self) -> None:
        """To the place where the photos' surfaces show it."""
        found, scene = self.clicked().masks[:, 0] > 0.5, self._scene
        geometry, pair = true_geometry(scene.views), [1, 0]
        where, same = shared_surface(
            geometry.depths[0, pair],
            scene.views.intrinsics[0, pair],
            geometry.c2w[0, pair],
            SAME_SURFACE,
        )
        there = (warp(found[:1].float(), where, padding="zeros")[0] > 0.5) & same
        both, either = (found[1] & there).sum(), (found[1] | there).sum()
        overlap = (both / either.clamp(min=1)).item()
        self.require(
            overlap > SHARED,
            f"on photo 2 the mask overlaps by {overlap:.0%} with what photo 1's shows there; carry "
            "it by the geometry (edit3r.kit.geometry.warping.shared_surface).",
        )

    def test_every_other_mark_is_obeyed_or_refused(self) -> None:
        """A box, a stroke, a place, a brush, a mask: none is ignored."""
        for what, marks in self._marks().items():
            found = self.select(Selection(**marks), what)
            if found is not None:
                self._require_in(found, self._centre(1), wanted=True)
                self.require(
                    not bool((found.masks[0] > 0.5).all()),
                    f"{what} selected all of photo 1, as if it were not there.",
                )
        erased = {"removed": {0: self._scene.objects[1, 0, 0]}}
        clicks = ((0, *self._centre(0)), (0, *self._centre(1)))
        found = self.select(Selection(positive=clicks, **erased), "an eraser")
        if found is not None:
            self._require_in(found, self._centre(1), wanted=False)

    def test_outlines_grow_and_shrink(self) -> None:
        """By `selection.grow` pixels."""
        areas = [
            float((self.clicked(grow=by).masks[0] > 0.5).sum()) for by in (-2, 0, 2)
        ]
        self.require(
            areas[0] < areas[1] < areas[2],
            f"with grow -2, 0 and 2 the mask has {areas} pixels; move the outline by "
            "selection.grow (edit3r.kit.geometry.maps.dilate).",
        )

    def test_inverted_is_all_but_the_thing(self) -> None:
        """On photos that show it."""
        rest = self.clicked(inverted=True)
        self._require_in(rest, self._centre(1), wanted=False)
        inside = self.clicked().masks[0, 0] > 0.5
        self.require(
            bool((rest.masks[0, 0][~inside] > 0.5).any()),
            "inverted selects nothing; return 1 - masks on photos that show the thing.",
        )

    def test_marks_on_no_photo_are_refused(self) -> None:
        found = self.select(Selection(positive=((7, 0.5, 0.5),)), "a click on photo 8")
        self.require(
            found is None, "a click on photo 8 of 3 was taken; raise InputError."
        )

    def test_words_that_nobody_knows_are_a_question(self) -> None:
        """Or refused."""
        words = f"{NEVER_HEARD!r}"
        found = self.select(Selection(words=NEVER_HEARD), words)
        self.require(
            found is None or not found.is_sure,
            f"something was surely selected for {words}; raise InputError, or return a low "
            "confidence.",
        )

    def test_same_marks_give_the_same_masks(self) -> None:
        fix = "seed what is random (k-means, sampling) from the settings"
        self.require_same_twice(lambda: self.clicked().masks, "marks", fix)

    def test_leaves_its_inputs_alone(self) -> None:
        views = self.scene(3).views
        geometry = true_geometry(views)
        selection = Selection(positive=((0, *self._centre(1)),))
        tensors = (views.images, geometry.depths, geometry.c2w)
        before = [tensor.clone() for tensor in tensors]
        self.ask(asking.select, views, selection, geometry)
        for tensor, copy in zip(tensors, before):
            self.require_equal("its input was changed", tensor, copy, "work on a copy")

    @property
    def _scene(self) -> Photographed:
        return self.scene(3)

    def _centre(self, ball: int) -> tuple[float, float]:
        """x and y in [0, 1] of the middle of a ball on photo 1."""
        ys, xs = torch.nonzero(self._scene.objects[ball, 0, 0], as_tuple=True)
        height, width = self.image_size
        y, x = (float(one.float().mean()) + 0.5 for one in (ys, xs))
        return x / width, y / height

    def _marks(self) -> Mapping[str, Mapping[str, Any]]:
        """The second ball, marked in every way but by a click."""
        x, y = self._centre(1)
        ball = self._scene.objects[1, 0, 0]
        box = (x - 0.08, y - 0.08, 0.16, 0.16)
        return {
            "a box": {"boxes": {0: box}},
            "a stroke": {"strokes": ((0, ((x - 0.03, y), (x, y), (x + 0.03, y))),)},
            "a place": {"regions": ((0, box),)},
            "a brush": {"added": {0: ball}},
            "a mask": {"masks": {0: ball}},
        }

    def _require_in(
        self, found: Selected, place: tuple[float, float], wanted: bool
    ) -> None:
        height, width = self.image_size
        row, column = int(place[1] * height), int(place[0] * width)
        inside = float(found.masks[0, 0, row, column]) > 0.5
        told = "selected though it was said not to be" if inside else "not selected"
        self.require(
            inside == wanted,
            f"the place ({place[0]:.2f}, {place[1]:.2f}) of photo 1 is {told}; masks obey marks.",
        )
