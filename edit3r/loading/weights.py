"""The weights that installed components declare."""

from collections.abc import Mapping

from edit3r.contract.errors import InputError, suggest
from edit3r.contract.weights import Weights
from edit3r.loading.registry import default_registry


def declared(local_files: tuple[str, ...] = ()) -> dict[str, Weights]:
    """All weights that installed components name, by name; those of plugins in local files too."""

    found: dict[str, Weights] = {}
    for offer in default_registry(local_files).offers():
        for weights in offer.component.weights:
            found.setdefault(weights.name, weights)
    return dict(sorted(found.items()))


def named(name: str, known: Mapping[str, Weights] | None = None) -> Weights:
    """The weights called `name`; raises InputError for a name that no installed component
    declares.
    """
    known = declared() if known is None else known
    if name not in known:
        raise InputError(
            f"no weights named {name!r}.{suggest(name, known)} See: edit3r weights list"
        )
    return known[name]
