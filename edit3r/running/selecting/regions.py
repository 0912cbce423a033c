"""Where each instruction of a sentence applies: masks of its thing in every view.

Marks (clicks, boxes, masks) stand for the thing that the sentence names, and its name tells how far
it goes around a click. In "the background" and "everything except the fox" they stand for what is
left out. What is not marked is looked up by its name.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import InputError, PromptError
from edit3r.contract.instructions import (
    BENEATH,
    FLOOD,
    Change,
    Colour,
    Instruction,
    Target,
)
from edit3r.contract.interfaces import (
    BACKGROUND,
    Geometry,
    Selected,
    Selection,
    Selector,
)
from edit3r.contract.reporting import note, say, warn
from edit3r.contract.types import Views
from edit3r.kit import asking
from edit3r.kit.geometry.maps import dilate
from edit3r.running.selecting.near_colour import near_colour

PLAIN = Selection()
MARKED = "what was marked"  # of what has no name; a further one has a number
FAINT = 0.01  # a probability below is none: such pixels keep their exact values
LEFT = 0.5  # share of a thing that must be left beside what is kept of it
RIM = 0.012  # half of how thick a rim between two outlines may be [longer sides]
Masks = Float[Tensor, "view height width"]


@dataclass(frozen=True)
class Regions:
    """Soft masks of the instructions of one scene, and how each was found."""

    # in [0, 1]; 1: the instruction applies
    masks: Float[Tensor, "instruction view height width"]
    selected: tuple[Selected, ...]  # every thing that was looked for, in order
    # masks of what has a name
    things: Mapping[str, Masks] = field(default_factory=dict)
    # as asked, with colours that were read off things
    instructions: tuple[Instruction, ...] = ()


class RegionFinder:
    """Finds the things of instructions in the views of one scene; a thing is looked for once."""

    def __init__(
        self,
        views: Views,
        selector: Callable[[], Selector],
        geometry: Callable[[], Geometry | None],
        marked: Selection | None = None,
        defaults: Selection = PLAIN,
        known: Mapping[str, Masks] | None = None,
    ) -> None:
        """`views` hold one scene; selector and geometry are asked for only where needed.

        `defaults` say what to do with outlines; `known` are masks of things
        that were named before.
        """
        self._views = views
        self._selector = selector
        self._geometry = geometry
        self._marked = marked
        self._defaults = defaults
        self._known = dict(known or {})
        self._found: dict[Target | None, Selected] = {}

    def find(self, instructions: Sequence[Instruction]) -> Regions:
        """Where each instruction applies. Raises InputError for what cannot be found."""
        marked_thing = self._thing_of_marks(instructions)
        self._name_marks(marked_thing)
        masks = [
            self._region(instruction, marked_thing) for instruction in instructions
        ]
        coloured = tuple(
            self._with_colours(instruction, marked_thing)
            for instruction in instructions
        )
        found = tuple(self._found.values())
        return Regions(torch.stack(masks), found, self._things(marked_thing), coloured)

    def _with_colours(
        self, instruction: Instruction, marked_thing: Target | None
    ) -> Instruction:
        """The instruction with the colours that it takes from other things."""
        changes = tuple(
            self._coloured(one, instruction, marked_thing)
            for one in instruction.changes
        )
        return replace(instruction, changes=changes)

    def _coloured(
        self, change: Change, instruction: Instruction, marked_thing: Target | None
    ) -> Change:
        if change.like is None:
            return change
        try:
            if change.like.of == BENEATH:
                mask = _beneath(self._base(instruction, marked_thing))
            else:
                mask = self._mask(change.like, marked_thing)
                found = self._found.get(replace(change.like, part=None))
                if found is not None and "guess" in found.how:
                    raise InputError(found.warnings[0])
        except InputError as error:
            raise InputError(
                f"the colour of {change.like} cannot be read: {error} Where clicks mark what is "
                "painted, name the colour instead, such as beige or #8a7f70."
            ) from None
        rgb = _median_colour(self._views.images[0], mask)
        return replace(change, colour=Colour(f"colour of {change.like}", rgb))

    def _things(self, marked_thing: Target | None) -> dict[str, Masks]:
        """Masks of everything that has a name, those of earlier runs first."""
        things = dict(self._known)
        marked = self._marked or PLAIN
        if self._defaults.inverted != marked.inverted:  # the masks are of all else
            return things
        for thing, selected in self._found.items():
            thing = thing or marked_thing
            elsewhere = selected.fits is False
            if thing is not None and thing.scope == "named" and not elsewhere:
                name = _name(thing)
                things.pop(name, None)  # the newest is the last
            elif self._marked is not None and (thing is None or thing == marked_thing):
                name = _free(MARKED, things)  # it has no name, but was changed
            else:
                continue
            things[name] = selected.masks[:, 0]
        return things

    def _thing_of_marks(self, instructions: Sequence[Instruction]) -> Target | None:
        """The one thing that the marks stand for; None for one that has no name."""
        if self._marked is None:
            return None
        sources = [
            one.like
            for instruction in instructions
            for one in instruction.changes
            if one.like
        ]
        clicked = [thing for thing in sources if thing.scope == "marked"]
        if clicked:  # "paint the door the colour of what I clicked on"
            return clicked[0]
        _refuse_places_and_marks(instructions)
        wanted = [
            instruction.target
            for instruction in instructions
            if instruction.target.scope in ("named", "marked")
        ]
        if not wanted:
            wanted = [
                thing for instruction in instructions for thing in instruction.without
            ]
        names = {thing.name: thing for thing in wanted}
        if len(names) > 1:
            listed = " and ".join(repr(name) for name in names)
            raise PromptError(
                f"the sentence names {listed}, and clicks, boxes or masks say one place; ask for "
                "one, then for the next with --from the first run's folder."
            )
        return next(iter(names.values()), None)

    def _name_marks(self, thing: Target | None) -> None:
        """Clicks on a whole thing are helped by its name; a part's name is seldom known."""
        marked = self._marked
        if marked is None or thing is None:
            return
        if marked.positive and not thing.of:
            self._marked = replace(marked, words=marked.words or thing.name)
        for word in thing.unknown:
            warn(
                f"{word!r} in {thing.name!r} is not known here; what is marked is changed, "
                "whatever it is called."
            )

    def _region(self, instruction: Instruction, marked_thing: Target | None) -> Masks:
        thing = instruction.target
        mask = self._base(instruction, marked_thing)
        for kept in instruction.without:
            rest = mask * (1 - self._mask(kept, marked_thing))
            if self._is_denied(mask, rest, kept, instruction):
                continue
            mask = rest
            if kept.name and kept.name == thing.name:  # "the cups but the middle one"
                mask = _without_rims(mask)
        if thing.part is not None:
            mask = near_colour(mask, self._views.images[0], thing.part)
        return mask

    def _is_denied(
        self, mask: Masks, rest: Masks, kept: Target, instruction: Instruction
    ) -> bool:
        """Whether what was found unsurely for a thing to keep is the thing to change itself: "the
        fern, not the planter" says that these are two.
        """
        found = self._found.get(replace(kept, part=None))
        unsure = found is not None and not found.is_sure
        other = (
            instruction.target.scope == "named" and kept.name != instruction.target.name
        )
        if not (unsure and other and kept.part is None):
            return False
        left = float((rest > 0.5).sum() / (mask > 0.5).sum().clamp(min=1))
        if left >= LEFT:
            return False
        warn(
            f"what was found for {kept.name!r} is {instruction.target.name!r} itself, so it is not "
            "left out; to leave it out, mark what is to change (--point X,Y)."
        )
        return True

    def _base(self, instruction: Instruction, marked_thing: Target | None) -> Masks:
        """The instruction's thing before anything is taken out of it."""
        thing, whole = instruction.target, torch.ones_like(self._views.images[0, :, 0])
        if thing.scope in ("named", "region"):
            return self._mask(thing, marked_thing)
        if thing.scope == "whole":
            if thing.name == "it" and self._known and self._marked is None:
                return self._mask(Target(), None)  # what was named last
            confined = self._marked is not None and not instruction.without
            return self._mask(None, None) if confined else whole
        if thing.scope == "marked":
            return self._mask(thing, thing)
        if instruction.without:  # the background of what is named beside it
            return whole
        return self._background()

    def _background(self) -> Masks:
        """All but what is marked, or what the segmenter takes for the background."""
        if self._marked is not None:
            return 1 - self._look_for(None, self._marked).masks[:, 0]
        if self._known:  # all but what earlier runs named
            named = torch.stack(list(self._known.values())).amax(0)
            return 1 - named
        asked = Selection(words=BACKGROUND)
        selected = self._look_for(Target("background"), asked)
        masks = selected.masks[:, 0]
        return 1 - masks if "guess" in selected.how else masks

    def _mask(self, thing: Target | None, marked_thing: Target | None) -> Masks:
        """Masks of a thing: what is marked where the marks stand for it, else by its name."""
        if thing is not None and thing.box is not None:
            place = Selection(regions=((0, thing.box),))
            return self._look_for(thing, place).masks[:, 0]
        stands_for = thing is None or marked_thing is None or _same(thing, marked_thing)
        if self._marked is not None and stands_for:
            return self._look_for(None, self._marked).masks[:, 0]
        if thing is None or (thing.scope != "named" and thing.part is None):
            if thing is not None and self._known:  # "paint it red"
                return self._look_for(thing, self._as_known([*self._known][-1])).masks[
                    :, 0
                ]
            return self._look_for(None, Selection()).masks[:, 0]
        if thing.scope == "whole" and thing.part is not None:  # "except the red parts"
            whole = torch.ones_like(self._views.images[0, :, 0])
            return near_colour(whole, self._views.images[0], thing.part)
        return self._named_mask(thing)

    def _named_mask(self, thing: Target) -> Masks:
        """Masks of a thing by its name, or of its pixels near a colour."""
        asked = Selection(
            words=thing.name, qualifiers=thing.qualifiers, several=thing.several
        )
        if _name(thing) in self._known:
            asked = self._as_known(_name(thing))
        mask = self._look_for(thing, asked).masks[:, 0]
        if thing.part is not None:
            mask = near_colour(mask, self._views.images[0], thing.part)
        return mask

    def _as_known(self, name: str) -> Selection:
        """The masks that an earlier run has of a thing."""
        say("selection.known", f"{name} is what the earlier run took for it")
        return Selection(masks=dict(enumerate(self._known[name])))

    def _look_for(self, thing: Target | None, selection: Selection) -> Selected:
        key = None if thing is None else replace(thing, part=None)
        if key not in self._found:
            selection = _with_defaults(selection, self._defaults)
            carried = len(selection.masks) < self._views.count
            geometry = self._geometry() if carried else None
            given = _as_given(selection, self._views.images[0])
            if given is None:
                selector = self._selector()
                given = asking.select(selector, self._views, selection, geometry)
            called = selection.words if thing is None else str(thing)
            self._found[key] = replace(given, called=called)
        return self._found[key]


def _as_given(
    selection: Selection, images: Float[Tensor, "view 3 height width"]
) -> Selected | None:
    """Masks that somebody gave for all views, which nobody need look for; None of all else."""
    masks = selection.masks
    as_they_are = not selection.inverted and not selection.grow
    only_masks = selection == replace(PLAIN, masks=masks) if as_they_are else False
    if not only_masks or sorted(masks) != list(range(len(images))):
        return None
    given = torch.stack([masks[view].to(images) for view in sorted(masks)])[:, None]
    if given.shape[-2:] != images.shape[-2:] or not bool(given.isfinite().all()):
        return None  # the selector says what is wrong
    how = ("given",) * len(images)
    note("selection", {"how": how})
    return Selected(torch.where(given < FAINT, 0, given.clamp(0, 1)), how)


def _free(name: str, taken: Collection[str]) -> str:
    """The name, with a number where it is taken."""
    if name not in taken:
        return name
    return f"{name} {sum(one.startswith(name) for one in taken) + 1}"


def _name(thing: Target) -> str:
    """The words that name a thing, such as "left cup"; all of a thing is the same thing."""
    which = (word for word in thing.qualifiers if word not in FLOOD)
    return " ".join((*which, thing.name)).strip()


def _refuse_places_and_marks(instructions: Sequence[Instruction]) -> None:
    places = [
        instruction.target
        for instruction in instructions
        if instruction.target.scope == "region"
    ]
    if (
        places
        and len(places) == len(instructions)
        and not any(w.without for w in instructions)
    ):
        raise PromptError(
            f"the sentence says the {places[0]}, but clicks, boxes or masks mark another place; "
            "keep only one of the two."
        )


def _same(thing: Target, other: Target) -> bool:
    """Whether marks of one stand for the other: not for "the middle one" of marked cups."""
    return thing.name == other.name and (
        thing.qualifiers == other.qualifiers or "all" not in other.qualifiers
    )


def _without_rims(masks: Masks) -> Masks:
    """The masks without what is thinner than things are: what two outlines of one thing differ by.

    "All cups" and "the middle cup" never end at the same pixel, and a ring of it would change.
    """
    reach = max(1, round(RIM * max(masks.shape[-2:])))
    outside = 1 - (masks > 0.5).to(masks)
    inner = 1 - dilate(outside, reach)
    return masks * dilate(inner, reach)


def _beneath(masks: Masks) -> Masks:
    """What lies under the lowest pixels of a thing, where it is as a rule stood on.

    Below its lower third alone: under a snout is air. Photos are taken to be upright.
    """
    height = masks.shape[1]
    rows = torch.arange(height).to(masks)[None, :, None]
    lowest = (rows * (masks > 0.5)).amax(1, keepdim=True)
    bottom = lowest.amax(2, keepdim=True)
    top = torch.where(masks > 0.5, rows, height).amin((1, 2), keepdim=True)
    stands = lowest > (top + 2 * bottom) / 3
    near = (rows > lowest + 0.01 * height) & (rows <= lowest + max(2, 0.05 * height))
    return (near & stands & (masks <= 0.5)).to(masks)


def _median_colour(
    images: Float[Tensor, "view 3 height width"], mask: Masks
) -> tuple[float, float, float]:
    """The median of each channel under a mask, over all photos [sRGB in [0, 1]]."""
    inside = images.movedim(1, 0)[:, mask > 0.5]
    if not inside.numel():
        raise InputError("a thing whose colour is asked for shows on no photo.")
    red, green, blue = inside.median(dim=1).values.tolist()
    return red, green, blue


def _with_defaults(selection: Selection, defaults: Selection) -> Selection:
    """A selection with what the run says of outlines beside its own."""
    return replace(
        selection,
        candidate=max(selection.candidate, defaults.candidate),
        larger=selection.larger + defaults.larger,
        grow=selection.grow + defaults.grow,
        inverted=selection.inverted != defaults.inverted,
    )
