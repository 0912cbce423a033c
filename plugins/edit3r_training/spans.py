"""Settings that are a least and a most."""

from typing import Annotated, TypeVar

from pydantic import AfterValidator

from edit3r.contract.settings import Index, NonNegative

Pair = TypeVar("Pair", bound=tuple[float, float])


def _in_order(pair: Pair) -> Pair:
    if pair[0] > pair[1]:
        raise ValueError("expected the smallest first, then the largest")
    return pair


Span = Annotated[tuple[NonNegative, NonNegative], AfterValidator(_in_order)]
CountSpan = Annotated[tuple[Index, Index], AfterValidator(_in_order)]
