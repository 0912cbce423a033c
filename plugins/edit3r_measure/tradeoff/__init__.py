"""Speed against accuracy, measured: sweep the settings of a run, find the front, choose the presets, obey budgets.

    knobs -> points -> sweep (each point in a fresh process: measure) -> figures -> front -> report, presets -> quality

`knobs.yaml` beside this file says what is swept; `edit3r/presets/quality.yaml` holds what was measured, and `quality`
reads it for `edit3r run`. Both are data: no component is named in the code.
"""
