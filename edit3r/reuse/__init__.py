"""Editing again: what a run computed is kept by content, and only what an edit touches changes.

`fingerprint` says what "the same" means, `store` how tensors lie on disk, `memory` and `parts` remember what matchers,
segmenters and reconstructors answered, `state` is the scene a run leaves to the next, `graft` puts an edit into it, and
`frames` draws again only what changed. Nothing here knows a component by name.
"""
