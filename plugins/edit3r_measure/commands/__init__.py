"""The commands `edit3r evaluate`, `edit3r tradeoff` and `edit3r bench`."""
