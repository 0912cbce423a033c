"""What other plugins may use: things of a scene by what is drawn over it."""

from edit3r_objects.drawn import Drawn, choose_drawn, read_drawn

__all__ = ["Drawn", "choose_drawn", "read_drawn"]
