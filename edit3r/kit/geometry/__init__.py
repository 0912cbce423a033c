"""Geometry as pure functions of tensors, for the core and every plugin. Conventions:
`edit3r.contract.types`.
"""
