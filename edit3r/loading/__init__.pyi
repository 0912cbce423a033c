"""What `edit3r.loading` promises, for type checkers and for the lazy loader of `__init__.py`."""

from .check import check_offer as check_offer
from .describe import SettingLine as SettingLine, settings_lines as settings_lines
from .load import load_plugins as load_plugins
from .registry import (
    absent_device as absent_device,
    declared as declared,
    install_hint as install_hint,
)
