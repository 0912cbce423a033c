"""Plugin vggt: says what it offers; the network loads when it is built."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_reconstructors():
    return [
        Component(
            "vggt",
            "edit3r_vggt.reconstructor:VggtReconstructor",
            "poses and depths of unposed photos by VGGT, a Gaussian a pixel",
            requires=("vggt",),
            extra="edit3r-vggt",
            licence="Apache-2.0; VGGT-1B's weights CC BY-NC 4.0",
            needs_network=True,
            citation="Wang et al., VGGT, CVPR 2025",
        )
    ]
