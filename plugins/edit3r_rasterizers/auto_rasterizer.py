"""The rasterizer that suits the device the Gaussians are on."""

import importlib.util
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r import reporting
from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Cameras, Gaussians, Rendering
from edit3r_rasterizers.numba_rasterizer import NumbaRasterizer
from edit3r_rasterizers.settings import RasterizerSettings


@dataclass(frozen=True)
class Choice:
    """The rasterizer that is used, and why, in words for the run's manifest."""

    name: str  # "numba" or "gsplat"
    reason: str


def choose(device: torch.device, has_gsplat: bool) -> Choice:
    """Choose gsplat for Gaussians on a CUDA device where it is installed, and numba for all
    else.
    """
    if device.type == "cpu":
        return Choice("numba", "the Gaussians are on the CPU")
    if device.type == "cuda" and has_gsplat:
        return Choice(
            "gsplat", f"the Gaussians are on {device} and gsplat is installed"
        )
    hint = (
        ' (pip install "edit3r[gsplat]" renders there)' if device.type == "cuda" else ""
    )
    return Choice(
        "numba",
        f"no rasterizer for {device} is installed{hint}, so the Gaussians are copied to the CPU",
    )


class AutoRasterizer(Rasterizer):
    """Hands each scene to the rasterizer that `choose` names, and notes name and reason in the
    run's manifest.
    """

    Settings = RasterizerSettings

    def __init__(self, settings: RasterizerSettings) -> None:
        self.settings = settings
        self._built: dict[str, Rasterizer] = {}

    def render(
        self,
        gaussians: Gaussians,
        cameras: Cameras,
        background: Float[Tensor, "*#batch_camera 3"] | None = None,
    ) -> Rendering:
        """Render on the best device at hand; the result is on the Gaussians' own."""
        device = gaussians.means.device
        choice = choose(
            device, has_gsplat=importlib.util.find_spec("gsplat") is not None
        )
        reporting.note("rasterizer.picked", choice.name)
        reporting.note("rasterizer.reason", choice.reason)
        rasterizer = self._get(choice.name)
        if choice.name == "gsplat" or device.type == "cpu":
            return rasterizer.render(gaussians, cameras, background)
        reporting.warn(f"rasterizer 'auto' picked 'numba': {choice.reason}.")
        return rasterizer.render(gaussians.to("cpu"), cameras.to("cpu"), background).to(
            device
        )

    def _get(self, name: str) -> Rasterizer:
        if name not in self._built:
            self._built[name] = _build(name, self.settings)
        return self._built[name]


def _build(name: str, settings: RasterizerSettings) -> Rasterizer:
    if name == "numba":
        return NumbaRasterizer(NumbaRasterizer.Settings(**settings.model_dump()))
    from edit3r_rasterizers.gsplat_rasterizer import GsplatRasterizer

    return GsplatRasterizer(GsplatRasterizer.Settings(**settings.model_dump()))
