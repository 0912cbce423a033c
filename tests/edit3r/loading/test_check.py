"""What a declaration lacks is said in one sentence."""

import pytest

from edit3r.loading.check import check_offer
from edit3r.loading.registry import default_registry

PLUGIN = """
from edit3r import Component, hookimpl
from edit3r.contract.interfaces import Writer

EDIT3R_API = 1


class Mine(Writer):
    needs = {needs!r}

    def write(self, path, scene):
        path.write_text("")


@hookimpl
def register_writers():
    told = {told!r}
    return [Component("mine", __name__ + ":Mine", "writes nothing", **told)]
"""
TOLD = {"suffix": ".mine", "keeps": "nothing", "loses": "all"}


@pytest.mark.parametrize(
    ("change", "needs", "told"),
    [
        ({}, (), ""),
        ({"suffix": ""}, (), "its suffix is ''; state how its files end"),
        ({"suffix": "mine"}, (), "its suffix is 'mine'"),
        ({"keeps": " "}, (), "does not say what it keeps of a scene"),
        ({"loses": ""}, (), "does not say what it loses of a scene"),
        ({}, ("camera",), "it needs 'camera', which no scene has; there are gaussians"),
    ],
)
def test_a_writer_says_what_it_writes_and_needs(tmp_path, change, needs, told):
    name = f"mine_{abs(hash((str(change), needs)))}"
    file = tmp_path / f"{name}.py"
    file.write_text(PLUGIN.format(needs=needs, told={**TOLD, **change}))
    registry = default_registry((str(file),))
    problem = check_offer(registry, registry.find("writer", "mine"))
    assert told in problem and bool(problem) == bool(told)
