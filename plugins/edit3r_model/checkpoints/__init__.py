"""Weights from and to files: official Lightning checkpoints, MASt3R (as initialisation), and our own format."""

from edit3r_model.checkpoints.fill import fill
from edit3r_model.checkpoints.load import load_weights
from edit3r_model.checkpoints.loaded import LoadedWeights, NetworkConfig, PartConfig
from edit3r_model.checkpoints.native import save_weights

__all__ = ["LoadedWeights", "NetworkConfig", "PartConfig", "fill", "load_weights", "save_weights"]
