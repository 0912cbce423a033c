"""Faster and smaller forms of the trained network's layers, for inference."""

from edit3r_model.engine.plan import EnginePlan, Precision, make_plan
from edit3r_model.engine.prepare import prepare_leaf

__all__ = ["EnginePlan", "Precision", "make_plan", "prepare_leaf"]
