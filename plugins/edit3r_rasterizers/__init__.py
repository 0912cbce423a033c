"""Rasterizers: 3D Gaussians and cameras to pictures. One convention, three implementations, and one that chooses."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_rasterizers():
    return [
        Component(
            "numba",
            "edit3r_rasterizers.numba_rasterizer:NumbaRasterizer",
            "Fast on CPUs: float32, multi-threaded, differentiable, the same bits for any number of threads.",
            requires=("numba",),
        ),
        Component(
            "torch",
            "edit3r_rasterizers.torch_rasterizer:TorchRasterizer",
            "Plain PyTorch reference: any device, float32 and float64, differentiable, slow.",
        ),
    ]
