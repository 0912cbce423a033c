"""Compile all kernels of the rasterizer `numba`: `python -m edit3r_rasterizers.compile_ahead`.

`NumbaRasterizer.prepare` runs it beside a first run after an install.
"""

import torch

from edit3r.contract.types import Cameras, Gaussians
from edit3r_rasterizers.numba_rasterizer import NumbaRasterizer, NumbaSettings


def main() -> None:
    """Draw a scene of one Gaussian and differentiate the image, which uses every kernel."""
    one = torch.ones(1, 1)
    gaussians = Gaussians(
        means=torch.tensor([[[0.0, 0.0, 2.0]]]),
        scales=torch.full((1, 1, 3), 0.1),
        quats=torch.tensor([[[1.0, 0.0, 0.0, 0.0]]]),
        opacities=one,
        harmonics=torch.zeros(1, 1, 4, 3).requires_grad_(True),
        view_index=torch.zeros(1, dtype=torch.long),
    )
    intrinsics = torch.tensor([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    cameras = Cameras(torch.eye(4)[None, None], intrinsics[None, None], (32, 32))
    images = NumbaRasterizer(NumbaSettings()).render(gaussians, cameras).images
    images.sum().backward()


if __name__ == "__main__":
    main()
