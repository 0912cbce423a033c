"""Cameras, rotations, harmonics and poses as pure tensor functions. Conventions: `edit3r.types`."""
