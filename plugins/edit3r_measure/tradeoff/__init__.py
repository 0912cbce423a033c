"""Kept for `edit3r.quality` until it has its own PRESETS and best_within."""
