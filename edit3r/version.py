"""The version of edit3r."""

__version__ = "0.1.0"
