"""Rasterizers turn 3D Gaussians and cameras into images: three implementations, and one that
chooses.
"""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_rasterizers():
    return [
        Component(
            "auto",
            "edit3r_rasterizers.auto_rasterizer:AutoRasterizer",
            "the rasterizer made for the device of the Gaussians, else the CPU's; the run says "
            "which and why.",
        ),
        Component(
            "numba",
            "edit3r_rasterizers.numba_rasterizer:NumbaRasterizer",
            "Fast on CPUs: float32, multi-threaded, differentiable, the same bits for any number "
            "of threads.",
            requires=("numba",),
            devices=("cpu",),
        ),
        Component(
            "torch",
            "edit3r_rasterizers.torch_rasterizer:TorchRasterizer",
            "Plain PyTorch reference: any device, float32 and float64, differentiable in the "
            "cameras too, slow.",
        ),
        Component(
            "gsplat",
            "edit3r_rasterizers.gsplat_rasterizer:GsplatRasterizer",
            "gsplat's CUDA kernels, for NVIDIA GPUs; needs the extra edit3r[gsplat].",
            extra="gsplat",
            requires=("gsplat",),
            devices=("cuda",),
        ),
    ]
