"""What other plugins may use: scenes of any program, read, and written again."""

from edit3r_outputs.reading import load_scene
from edit3r_outputs.saved import SavedScene, write_saved

__all__ = ["SavedScene", "load_scene", "write_saved"]
