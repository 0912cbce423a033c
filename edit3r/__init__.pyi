"""What `edit3r` promises, for type checkers and for the lazy loader of `__init__.py`."""

from .api import run as run
from .contract.command import Command as Command
from .contract.component import Component as Component
from .contract.errors import Edit3rError as Edit3rError
from .contract.hookspecs import hookimpl as hookimpl
from .contract.interfaces import Selection as Selection
from .contract.settings import PartChoice as PartChoice, Settings as Settings
from .contract.types import (
    Cameras as Cameras,
    EditRequest as EditRequest,
    Features as Features,
    Gaussians as Gaussians,
    Reconstruction as Reconstruction,
    Rendering as Rendering,
    Views as Views,
)
from .kit.cache import Cache as Cache
from .kit.photos.images import load_views as load_views
from .kit.scenes.ply import load_ply as load_ply, save_ply as save_ply
from .loading.registry import (
    Registry as Registry,
    build as build,
    components as components,
    default_registry as default_registry,
)
from .running.config import RunConfig as RunConfig
from .running.result import RunResult as RunResult
from .running.selecting.call import select as select
from .version import __version__ as __version__
