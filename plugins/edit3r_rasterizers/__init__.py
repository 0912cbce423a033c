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
            "gsplat for Gaussians on a CUDA device where it is installed, else numba; the run "
            "says which and why.",
            requires=("numba",),
        ),
        Component(
            "numba",
            "edit3r_rasterizers.numba_rasterizer:NumbaRasterizer",
            "Fast on CPUs: float32, multi-threaded, differentiable, the same bits for any number "
            "of threads.",
            requires=("numba",),
        ),
        Component(
            "torch",
            "edit3r_rasterizers.torch_rasterizer:TorchRasterizer",
            "Plain PyTorch reference: any device, float32 and float64, differentiable in the "
            "cameras too, slow.",
        ),
        # No `requires`: where there is no CUDA, "install gsplat" would be the wrong advice. The
        # class says what to do.
        Component(
            "gsplat",
            "edit3r_rasterizers.gsplat_rasterizer:GsplatRasterizer",
            "gsplat's CUDA kernels, for NVIDIA GPUs; needs the extra edit3r[gsplat].",
            extra="gsplat",
            needs_gpu=True,
        ),
    ]
