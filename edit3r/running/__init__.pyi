"""What `edit3r.running` promises, for type checkers and for the lazy loader of `__init__.py`."""

from .components import Components as Components
from .config import (
    DEFAULTS as DEFAULTS,
    MAX_GROWTH as MAX_GROWTH,
    MAX_PROMPT as MAX_PROMPT,
    MAX_STEPS as MAX_STEPS,
    PART_KEYS as PART_KEYS,
    JobInputs as JobInputs,
    RunConfig as RunConfig,
    check_components as check_components,
    make_run_config as make_run_config,
)
from .editors import instructions_for as instructions_for, usual_reader as usual_reader
from .flags import (
    add_flags as add_flags,
    add_mark_flags as add_mark_flags,
    given_flags as given_flags,
)
from .geometry import (
    GeometryAnswer as GeometryAnswer,
    default_matcher as default_matcher,
    geometry_answer as geometry_answer,
    geometry_of as geometry_of,
)
from .job import RunJob as RunJob, job_from as job_from
from .measuring import read_metres as read_metres
from .pipeline import preview as preview, preview_photo as preview_photo, run as run
from .quality import PRESETS as PRESETS, SHIPPED as SHIPPED
from .records import Preview as Preview
from .result import (
    RunResult as RunResult,
    write_result as write_result,
)
from .run_folder import (
    CACHE as CACHE,
    EarlierRun as EarlierRun,
    RunFolder as RunFolder,
)
from .scene_input import (
    SCENE_ENDINGS as SCENE_ENDINGS,
    SceneInput as SceneInput,
    make_scene_input as make_scene_input,
)
from .selecting.call import select_with as select_with, usual_selector as usual_selector
from .selecting.marks import MarkTexts as MarkTexts
