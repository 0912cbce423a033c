"""The small form: matched geometry repaired by a small network that carries and fuses the edits."""
