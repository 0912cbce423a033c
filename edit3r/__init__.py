"""edit3r: edit 3D scenes from a few photos. Every stage is a plugin.

The public names stand in `__init__.pyi` and load on first use, so `import edit3r` stays cheap (no
torch) and a plugin's declaration module can import `Component` and `hookimpl` without paying for
anything else.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
