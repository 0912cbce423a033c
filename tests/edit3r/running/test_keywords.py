"""A run's settings are defined once: keywords, flags and the batch's keys name the same."""

import argparse
import inspect

import edit3r
from edit3r.running.config import RunConfig
from edit3r.running.flags import OUTLINE, SHORT, add_flags, add_mark_flags
from edit3r.running.keywords import RunKeywords

OF_THE_CALL = {"prompt", "editor", "reconstructor"}
"""Settings that `edit3r.run` has as parameters of its own."""


def test_the_keywords_of_the_call_are_the_settings_of_a_run():
    assert set(RunKeywords.__annotations__) == set(RunConfig.model_fields) - OF_THE_CALL
    parameters = inspect.signature(edit3r.run).parameters
    own = {SHORT.get(name, name) for name in OF_THE_CALL}
    assert own < set(parameters) and len(parameters) <= 14
    assert not set(parameters) & set(RunKeywords.__annotations__)


def test_every_setting_has_a_flag_but_lists_of_components():
    parser = argparse.ArgumentParser(prog="run")
    add_flags(parser, RunConfig)
    add_mark_flags(parser)
    flags = {action.dest for action in parser._actions}
    assert set(RunConfig.model_fields) - flags == {"refiners"}
    assert set(OUTLINE) < flags
