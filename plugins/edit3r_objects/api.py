"""What other plugins may use: holes behind removed things, closed."""

from edit3r_objects.holes import patch

__all__ = ["patch"]
