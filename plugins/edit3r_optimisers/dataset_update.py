"""Pictures that are edited anew, one after the other, while a scene is fitted to them.

Instruct-NeRF2NeRF's iterative dataset update (Haque et al. 2023, section 4.2): every few steps a view is rendered,
noised, and denoised with the unedited photo as condition; the result replaces the view's picture.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch

from edit3r.interfaces import Editor, Rasterizer
from edit3r.types import Cameras, EditRequest, Gaussians, Views
from edit3r_optimisers.edits import edited_from, for_views
from edit3r_optimisers.schedule import view_at

__all__ = ["Renewal", "RenewedPictures"]


@dataclass(frozen=True)
class Renewal:
    """When and how pictures are renewed."""

    every: int  # steps
    views: int  # at once
    strengths: tuple[float, float]  # least and most, in [0, 1]; 1: nothing of the render stays
    fresh_noise: bool  # another seed for every edit


class RenewedPictures:
    """Starts as the photos; `renewals` counts the edits that replaced one or more of them."""

    def __init__(
        self,
        photos: Views,
        cameras: Cameras,
        request: EditRequest,
        renewal: Renewal,
        editor: Editor,
        rasterizer: Rasterizer,
    ) -> None:
        self.photos, self.cameras, self.request, self.renewal = photos, cameras, request, renewal
        self.editor, self.rasterizer = editor, rasterizer
        self.images = photos.images[0].clone()
        self.renewals = 0

    def before(self, step: int, scene: Callable[[], Gaussians]) -> None:
        if step % self.renewal.every == 0:
            self._renew(scene())

    def state(self) -> dict[str, Any]:
        return {"images": self.images.clone(), "renewals": self.renewals}

    def restore(self, state: dict[str, Any]) -> None:
        self.images, self.renewals = state["images"], state["renewals"]

    @torch.no_grad()
    def _renew(self, gaussians: Gaussians) -> None:
        """Edit the next views, starting from how the scene shows them now."""
        count = min(self.renewal.views, self.photos.count)
        first = self.renewals * count
        # A round of all views may begin and end within one renewal; a view is edited once then.
        views = list(dict.fromkeys(view_at(first + k, self.photos.count, self.request.seed) for k in range(count)))
        start = self.rasterizer.render(gaussians, self.cameras.select(views)).images
        request = for_views(self.request, views)
        if self.renewal.fresh_noise:
            request = replace(request, seed=self.request.seed + self.renewals)
        answer = edited_from(self.editor, self.photos.select(views), start, request, self._strength())
        self.images[views] = answer.images[0]
        self.renewals += 1

    def _strength(self) -> float:
        """Drawn evenly between the limits, by seed and number of the edit."""
        generator = torch.Generator().manual_seed(self.request.seed * 1_000_003 + self.renewals)
        least, most = self.renewal.strengths
        return least + (most - least) * float(torch.rand((), generator=generator))
