"""Only the Gaussians a scene requires: drop what is never seen or seen twice, merge what is flat.

`simplify` in `edit3r.simplify.simplify` is the entry; each step has a file of its own.
"""

from edit3r.simplify.simplify import Simplified, SimplifySettings, simplify

__all__ = ["Simplified", "SimplifySettings", "simplify"]
