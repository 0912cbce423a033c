"""What other plugins may use of this one."""

from edit3r_refiners.clean import Floaters, find_floaters

__all__ = ["Floaters", "find_floaters"]
