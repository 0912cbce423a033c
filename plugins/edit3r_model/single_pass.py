"""The single pass: photos of any size through a network that finds geometry by itself.

Ye et al., No Pose, No Problem (ICLR 2025), and Edit3r, which trains the same network on edits. The
Gaussians come in the frame of view 0 without cameras: the caller finds these from the centres
(`edit3r.kit.geometry.pose`).
"""

from typing import Literal

import torch
from pydantic import Field

from edit3r.contract import settings as config
from edit3r.contract.errors import RunError, SettingsError
from edit3r.contract.reporting import note
from edit3r.contract.types import Reconstruction, Views
from edit3r.kit.weights.load import out_of_memory_told
from edit3r_model.engine import Precision
from edit3r_model.memory import ADVICE, check_fits, estimate_bytes
from edit3r_model.network import GaussianNetwork
from edit3r_model.view_fitting import fit_views

RESOLUTION = 256
"""Where neither settings nor weights say: side of the square with the area that images are scaled
down to [pixels].
"""


class SinglePassSettings(config.Settings):
    """What counts where the head takes no geometry."""

    resolution: int | None = Field(None, ge=16, le=4096)
    """single pass: photos are scaled down to at most this squared [pixels]; default: the weights',
    or 256
    """
    fit: Literal["resize", "pad"] = "resize"
    """single pass: how sides become multiples of the patch: stretched to the nearest, or padded"""
    precision: Precision | Literal["auto"] = "float32"
    """single pass: of the network: float32, bfloat16, float16 (CUDA); auto: bfloat16 where a
    product, timed while it loads, is faster than in float32
    """
    head_precision: Precision | Literal["auto"] = "auto"
    """single pass: of the head; auto: as the backbone"""
    device: str = "auto"
    """single pass: cpu, cuda, cuda:1, ...; auto: cuda where there is one"""


class SinglePass:
    """Images to the network's size, through the network, Gaussians to the size asked for."""

    def __init__(self, settings: SinglePassSettings, network: GaussianNetwork) -> None:
        if settings.fit == "pad" and network.head.per_pixel == 0:
            raise SettingsError(
                "reconstructor.fit: this head does not make its Gaussians pixel by pixel, so those "
                "of the padding cannot be left out; set fit=resize."
            )
        self.settings = settings
        self.network = network
        self.resolution = settings.resolution or RESOLUTION

    def __call__(self, views: Views) -> Reconstruction:
        """Reconstruct `views`; differentiable only while the network is in training mode.

        Raises InputError for views that cannot be used, RunError when memory ends.
        """
        chosen, backbone = self.settings, self.network.backbone
        fitted = fit_views(views, backbone.patch_size, self.resolution, chosen.fit)
        reconstruction = self._run(fitted.views).to(views.images.device)
        _require_finite(reconstruction)
        return fitted.drop_padding(reconstruction)

    def _run(self, views: Views) -> Reconstruction:
        """The network's own answer for views of a size that it takes."""
        learns = self.network.training and torch.is_grad_enabled()
        size = views.image_size
        note("reconstructor.network_input_size", list(size))
        what = f"reconstructing {views.count} views at {size[0]}x{size[1]}"
        device = (*self.network.parameters(), *self.network.buffers())[0].device
        needed = estimate_bytes(
            self.network.backbone,
            len(views.images),
            views.count,
            size,
            per_pixel=self.network.head.per_pixel,
        )
        check_fits(needed, device, what)
        with out_of_memory_told(what, ADVICE), torch.set_grad_enabled(learns):
            return self.network.reconstruct(views.to(device, torch.float32))


def _require_finite(reconstruction: Reconstruction) -> None:
    """Raise RunError that names the first tensor with NaN or infinite values."""
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        if not getattr(reconstruction.gaussians, name).isfinite().all():
            raise RunError(
                f"the network's {name} are not finite; in float16 this is an overflow: set "
                "reconstructor.precision to bfloat16 or float32."
            )
