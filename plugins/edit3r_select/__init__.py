"""Selecting as one sum: masks that answer marks, and which of them is meant.

`asking` gathers masks from anything that answers marks (any SAM, or `grabcut` without a network),
`cues` says what can be seen of each, `sum` adds it with the weights of `fitted.yaml`.
"""
