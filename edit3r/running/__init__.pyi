"""What `edit3r.running` promises, for type checkers and for the lazy loader of `__init__.py`."""

from .config import (
    DEFAULTS as DEFAULTS,
)
from .config import (
    MAX_GROWTH as MAX_GROWTH,
)
from .config import (
    MAX_PROMPT as MAX_PROMPT,
)
from .config import (
    MAX_STEPS as MAX_STEPS,
)
from .config import (
    PART_KEYS as PART_KEYS,
)
from .config import (
    JobInputs as JobInputs,
)
from .config import (
    RunConfig as RunConfig,
)
from .config import (
    check_components as check_components,
)
from .config import (
    make_run_config as make_run_config,
)
from .earlier import (
    CACHE as CACHE,
)
from .earlier import (
    read_earlier_run as read_earlier_run,
)
from .earlier import (
    read_views_of_run as read_views_of_run,
)
from .flags import (
    add_flags as add_flags,
)
from .flags import (
    add_mark_flags as add_mark_flags,
)
from .flags import (
    given_flags as given_flags,
)
from .job import (
    RunJob as RunJob,
)
from .job import (
    job_from as job_from,
)
from .judging.edit_verdict import EditVerdict as EditVerdict
from .judging.verdict import LABELS as LABELS
from .loop import (
    RunResult as RunResult,
)
from .loop import (
    preview as preview,
)
from .loop import (
    run as run,
)
from .parts import Parts as Parts
from .quality import (
    PRESETS as PRESETS,
)
from .quality import (
    Expected as Expected,
)
from .quality import (
    MeasuredPoint as MeasuredPoint,
)
from .quality import (
    Quality as Quality,
)
from .quality import (
    write_quality as write_quality,
)
from .reading import (
    usual_reader as usual_reader,
)
from .reading import (
    wishes_for as wishes_for,
)
from .saved import (
    SavedScene as SavedScene,
)
from .saved import (
    write_saved as write_saved,
)
from .scene import Scene as Scene
from .selecting.call import select_with as select_with
from .selecting.geometry import (
    default_matcher as default_matcher,
)
from .selecting.geometry import (
    geometry_of as geometry_of,
)
from .selecting.marks import MarkTexts as MarkTexts
from .selecting.select import (
    MIN_AREA as MIN_AREA,
)
from .selecting.select import (
    SURE as SURE,
)
from .selecting.select import (
    Box as Box,
)
from .selecting.select import (
    Reading as Reading,
)
from .selecting.select import (
    Selection as Selection,
)
from .selecting.select import (
    select_masks as select_masks,
)
from .write import write_result as write_result
