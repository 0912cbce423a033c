"""One working component of every kind, as `edit3r new-plugin` writes it, and a way to see what a
contract says.
"""

from collections.abc import Callable
from typing import Any

import pytest
from edit3r_develop.new_plugin import new_package

from edit3r.contract.component import KINDS
from edit3r.loading.registry import Registry
from edit3r_testing import Contract, ContractViolation


@pytest.fixture(scope="session")
def examples(tmp_path_factory) -> Registry:
    """A registry with a generated plugin `worked-KIND` of every kind."""
    from edit3r.loading.registry import default_registry

    parent = tmp_path_factory.mktemp("examples")
    folders = (new_package(kind, f"worked-{kind}", parent) for kind in KINDS)
    return default_registry(tuple(map(str, folders)))


@pytest.fixture(scope="session")
def complaint() -> Callable[..., str]:
    """What `claim` of `contract` says about a component; fails when it has nothing to say."""

    def complain(
        contract: type[Contract],
        build: Callable[[], Any],
        claim: str,
        **attributes: Any,
    ) -> str:
        bound = type(
            "Bound", (contract,), {"build": lambda self: build(), **attributes}
        )
        with pytest.raises(ContractViolation) as violation:
            getattr(bound(), claim)()
        text = str(violation.value)
        assert "\n" not in text, "a violation is one line"
        return text

    return complain
