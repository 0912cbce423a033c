"""The formats that a scene is exported in."""

FORMATS = {
    "spz": ".spz",
    "spz4": ".v4.spz",
    "sog": ".sog",
    "splat": ".splat",
    "compressed-ply": ".compressed.ply",
    "glb": ".glb",
    "ply": ".ply",
}
"""Formats that a scene is exported in, and the suffix of each one's files."""
CAMERA_FORMATS = {"colmap": "-colmap", "nerfstudio": "-nerfstudio"}
"""Formats that a run's cameras are exported in, and the end of each one's folder."""
