"""What other plugins may use: things of a scene by what is drawn over it."""

from edit3r_objects.drawn import Drawn, choose_drawn, read_drawn
from edit3r_objects.holes import patch

__all__ = ["Drawn", "choose_drawn", "patch", "read_drawn"]
