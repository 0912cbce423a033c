"""Only the Gaussians a scene requires: drop what is never seen or seen twice, merge what is flat.

`simplify` in `edit3r_refiners.simplify.simplification` is the entry; each step has a file of its own.
"""

from edit3r_refiners.simplify.settings import SimplifySettings
from edit3r_refiners.simplify.simplification import Simplified, simplify

__all__ = ["Simplified", "SimplifySettings", "simplify"]
