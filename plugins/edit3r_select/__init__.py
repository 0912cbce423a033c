"""Selectors: what is marked or named on some photos, on all of them."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_selectors():
    return [
        Component(
            "by-segmenter",
            "edit3r_select.by_segmenter:SegmenterSelector",
            "a segmenter's answers on each photo, carried to the others by geometry",
            parts=("segmenter",),
        )
    ]
