"""Measuring: `edit3r evaluate` and `edit3r tradeoff`."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_commands() -> list[Component]:
    return [
        Component(
            "evaluate",
            "edit3r_measure.evaluate:EvaluateCommand",
            "measure a reconstructor on photos with known cameras or on generated scenes",
        ),
        Component(
            "tradeoff",
            "edit3r_measure.tradeoff:TradeoffCommand",
            "measure speed against accuracy over the settings of a run, and choose the presets",
        ),
    ]
