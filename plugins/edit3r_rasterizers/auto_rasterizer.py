"""The rasterizer that suits the device the Gaussians are on."""

from jaxtyping import Float
from torch import Tensor

from edit3r import Registry, default_registry
from edit3r.contract import reporting
from edit3r.contract.component import Offer
from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import RENDERED, Cameras, Gaussians, Rendering
from edit3r_rasterizers.settings import RasterizerSettings


def choose(registry: Registry, device: str) -> tuple[Offer, str]:
    """The installed rasterizer made for a type of device that gives what one usually does, else
    one made for the CPU; and why.
    """
    offer = next(
        offer
        for kind in (device, "cpu")
        for offer in registry.offers("rasterizer")
        if kind in offer.component.devices
        and not registry.missing(offer)
        and _gives_all(registry, offer)
    )
    if device in offer.component.devices:
        return offer, f"made for {device}, where the Gaussians are"
    return offer, (
        f"no rasterizer made for {device} is installed, so the Gaussians are copied to the CPU"
    )


def _gives_all(registry: Registry, offer: Offer) -> bool:
    cls = registry.load_class(offer)
    return issubclass(cls, Rasterizer) and set(RENDERED) <= set(cls.gives)


class AutoRasterizer(Rasterizer):
    """Hands each scene to the rasterizer that `choose` names, and notes which and why."""

    Settings = RasterizerSettings
    settings: RasterizerSettings

    def __init__(self, settings: RasterizerSettings) -> None:
        self.settings = settings
        self._built: dict[str, Rasterizer] = {}

    def prepare(self, device: str) -> None:
        rasterizer, chosen = self._on(device)
        rasterizer.prepare(chosen)

    def render(
        self,
        gaussians: Gaussians,
        cameras: Cameras,
        background: Float[Tensor, "*#batch_camera 3"] | None = None,
    ) -> Rendering:
        """Render on the best device at hand; the result is on the Gaussians' own."""
        given = () if background is None else (background,)
        rasterizer, device = self._on(gaussians.means.device.type)
        if device == gaussians.means.device.type:
            return rasterizer.render(gaussians, cameras, *given)
        moved = (one.to(device) for one in (gaussians, cameras, *given))
        return rasterizer.render(*moved).to(gaussians.means.device)

    def contributions(
        self,
        gaussians: Gaussians,
        cameras: Cameras,
        weights: Float[Tensor, "camera *map height width"] | None = None,
    ) -> Float[Tensor, "batch gaussian *map"]:
        rasterizer, device = self._on(gaussians.means.device.type)
        weights = None if weights is None else weights.to(device)
        sums = rasterizer.contributions(
            gaussians.to(device), cameras.to(device), weights
        )
        return sums.to(gaussians.means.device)

    def _on(self, device: str) -> tuple[Rasterizer, str]:
        """The rasterizer for Gaussians on a type of device, and the type that it renders on."""
        offer, reason = choose(default_registry(), device)
        name = offer.qualified_name
        reporting.note("rasterizer.picked", offer.component.name)
        reporting.note("rasterizer.reason", reason)
        if device not in offer.component.devices:
            reporting.warn(
                f"rasterizer 'auto' picked {offer.component.name!r}: {reason}."
            )
            device = "cpu"
        if name not in self._built:
            self._built[name] = self._build(offer)
        return self._built[name], device

    def _build(self, offer: Offer) -> Rasterizer:
        """Build it with those of this one's settings that it has too."""
        registry = default_registry()
        known = registry.settings_class(offer).model_fields
        chosen = self.settings.model_dump(exclude_none=True)
        values = {k: v for k, v in chosen.items() if k in known}
        return registry.build("rasterizer", offer.qualified_name, **values)
