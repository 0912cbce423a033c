"""Installed plugins: found, described, checked.

A name in `__init__.pyi` is promised; the modules behind may change. Each loads on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
