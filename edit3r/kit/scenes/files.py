"""Where the file of a saved scene is."""

from pathlib import Path


def scene_file(text: str) -> Path:
    """Argument type of a saved scene: its file, or the run folder that holds a `scene.ply`."""
    path = Path(text)
    return path / "scene.ply" if path.is_dir() else path
