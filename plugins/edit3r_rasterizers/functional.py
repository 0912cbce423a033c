"""The CPU rasterizer as one function of tensors, in the conventions of gsplat."""

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.cameras import from_pixels, invert_rigid
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r_rasterizers.numba_rasterizer import NumbaRasterizer, NumbaSettings

RENDER_MODES = ("RGB", "D", "ED", "RGB+D", "RGB+ED")


def rasterization(
    means: Float[Tensor, "gaussian 3"],
    quats: Float[Tensor, "gaussian 4"],
    scales: Float[Tensor, "gaussian 3"],
    opacities: Float[Tensor, "gaussian"],
    colors: Float[Tensor, "gaussian *coefficient 3"],
    viewmats: Float[Tensor, "camera 4 4"],
    Ks: Float[Tensor, "camera 3 3"],
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    *,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    backgrounds: Float[Tensor, "camera 3"] | None = None,
    render_mode: str = "RGB",
    **unsupported: object,
) -> tuple[Tensor, Tensor, dict[str, int]]:
    """Draw Gaussians on the CPU as `gsplat.rasterization` does; differentiable in all tensors.

    `quats` wxyz of any norm; `viewmats` world to camera, OpenCV axes, rigid, and their gradients
    are those along rigid motions; `Ks` in pixels, pixel centres at +0.5, skew ignored; `colors`
    [N, 3] as they are, or with `sh_degree` the harmonics [N, K, 3], of which the first
    (sh_degree + 1)^2 are used. `render_mode`: RGB, D (summed camera z), ED (that over alpha), RGB+D
    or RGB+ED. Returns the image [C, H, W, 3, 1 or 4], alphas [C, H, W, 1], and a dict of width,
    height and n_cameras. Raises InputError for what gsplat has beyond this, and ValueError for
    other shapes.
    """
    if unsupported:
        raise InputError(
            f"rasterization: gsplat's {', '.join(unsupported)} is not available on the CPU; leave "
            "it out."
        )
    if render_mode not in RENDER_MODES:
        raise InputError(
            f"rasterization: expected render_mode in {RENDER_MODES}, got {render_mode!r}."
        )
    lift = 0.0
    if sh_degree is None:
        # Drawn as 0.5 at least: a colour of 0 or less is clamped, and gets no gradient.
        lift = 0.5 - float(colors.detach().cpu().numpy().min(initial=0))
        harmonics = colour_to_dc(colors + lift)[:, None]
    else:
        harmonics = colors[:, : (sh_degree + 1) ** 2]
        if sh_degree != round(harmonics.shape[1] ** 0.5) - 1:
            raise InputError(
                f"rasterization: sh_degree {sh_degree} needs {(sh_degree + 1) ** 2} coefficients, "
                f"colors have {colors.shape[1]}."
            )
    c2w = invert_rigid(viewmats.double())
    turns = viewmats[:, :3, :3].double() @ c2w[:, :3, :3]
    if not torch.allclose(turns, torch.eye(3).double(), atol=1e-3):
        raise InputError(
            "rasterization: viewmats must be rigid, a rotation and a translation."
        )
    size = height, width
    cameras = Cameras(c2w[None], from_pixels(Ks.double(), size)[None], size)
    settings = NumbaSettings(near_plane=near_plane, far_plane=far_plane, eps2d=eps2d)
    fields = (field[None] for field in (means, scales, quats, opacities, harmonics))
    rendering = NumbaRasterizer(settings).render(
        Gaussians(*fields), cameras, backgrounds
    )
    alphas, depths = rendering.alphas[0], rendering.depths[0]
    shown = {
        "RGB": rendering.images[0] - lift * alphas,
        "D": depths * alphas,
        "ED": depths,
    }
    images = torch.cat([shown[part] for part in render_mode.split("+")], 1)
    meta = {"width": width, "height": height, "n_cameras": len(viewmats)}
    return images.movedim(1, -1), alphas.movedim(1, -1), meta
