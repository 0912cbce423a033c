"""Geometry as pure functions of tensors. Conventions: `edit3r.contract.types`."""
