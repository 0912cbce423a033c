"""The components of a run are those that its settings name, and its photos call for."""

from dataclasses import replace
from pathlib import Path

from edit3r.contract.component import component_name
from edit3r.loading.registry import default_registry
from edit3r.running.components import Components
from edit3r.running.config import make_run_config
from edit3r.running.job import RunJob
from edit3r_testing import photograph

SCENE = photograph(2, (32, 48))
POSED = replace(SCENE.views, c2w=SCENE.cameras.c2w)


def matcher_of(photos, **settings):
    """The matcher that is asked, where another one was before the poses were known."""
    config = make_run_config({"reconstructor": "classical", **settings})
    job = RunJob(config=config, photos=photos, cameras=Path("cameras.json"))
    components = Components(config, default_registry(), job)
    assert component_name(components.geometry_source) == "classical"
    components.settle_matcher(photos)
    return component_name(components.geometry_source)


def test_given_poses_are_used_unless_a_matcher_is_chosen():
    assert matcher_of(POSED) == "posed"
    assert matcher_of(POSED, matcher="classical") == "classical"
    assert matcher_of(SCENE.views) == "classical"
