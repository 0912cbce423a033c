"""What other plugins may use: saved scenes, written again."""

from edit3r_outputs.saved import SavedScene, write_saved

__all__ = ["SavedScene", "write_saved"]
