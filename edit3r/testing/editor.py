"""Contract of an editor."""

import torch

from edit3r.interfaces import Editor
from edit3r.pipeline import composite
from edit3r.testing.contract import Contract
from edit3r.testing.scenes import photograph
from edit3r.types import EditRequest, Views


class EditorContract(Contract):
    """Keeps number, size, range, dtype and cameras of the views; same seed, same result."""

    kind = "editor"
    subject: Editor
    prompt: str = "make it warmer"  # an instruction the editor can carry out
    image_size: tuple[int, int] = (48, 64)  # (height, width) [pixels]; larger for an editor that needs it

    def views(self, view_count: int | None = None, batch: int = 1, image_size: tuple[int, int] | None = None) -> Views:
        """Test photos, as many as the component's declaration allows (2 by default)."""
        least, most = self._view_limits()
        count = min(max(view_count or 2, least), most)
        return photograph(count, image_size or self.image_size, batch).views.to(self.device)

    def edit(self, views: Views, seed: int = 3, masks: torch.Tensor | None = None) -> Views:
        """One edit; what it raises or returns that is no Views becomes a violation."""
        batch, count, _, height, width = views.images.shape
        what = f"edit() of {batch} x {count} photos of {height}x{width}"
        edited = self.call(what, self.subject.edit, views, EditRequest(self.prompt, seed, masks))
        self.require(isinstance(edited, Views), f"edit() returned a {type(edited).__name__}; return edit3r.Views.")
        return edited

    def test_keeps_size_dtype_and_range(self) -> None:
        for size in (self.image_size, (self.image_size[0] + 1, self.image_size[1] - 3)):
            views = self.views(image_size=size)
            edited = self.edit(views)
            self.require_tensor("images of the edited views", edited.images, tuple(views.images.shape))
            self.require_range("images", edited.images, 0, 1, "clamp the result, for example with .clamp(0, 1)")

    def test_keeps_cameras_and_names(self) -> None:
        views = self.views()
        views = Views(views.images, views.intrinsics, tuple(f"photo-{i}" for i in range(views.count)))
        edited = self.edit(views)
        fix = "return dataclasses.replace(views, images=...) so that cameras and names stay"
        self.require_equal("intrinsics changed", edited.intrinsics, views.intrinsics, fix)
        self.require(edited.names == views.names, f"names changed from {views.names} to {edited.names}; {fix}.")

    def test_any_number_of_views_and_scenes(self) -> None:
        least, most = self._view_limits()
        for count in sorted({least, min(3, most), min(5, most)}):
            views = self.views(count)
            self.require_tensor(f"images edited from {count} views", self.edit(views).images, tuple(views.images.shape))
        views = self.views(batch=2)
        self.require_tensor("images edited from 2 scenes", self.edit(views).images, tuple(views.images.shape))

    def test_same_seed_gives_the_same_result(self) -> None:
        if self.offer is not None and not self.offer.component.supports_seed:
            return
        views = self.views()
        first = self.edit(views)
        torch.rand(3)  # an editor that draws from the global generator would now draw something else
        fix = "draw from torch.Generator().manual_seed(request.seed), or declare supports_seed=False"
        self.require_equal("the same seed gave two results", first.images, self.edit(views).images, fix, self.tolerance)

    def test_leaves_its_inputs_alone(self) -> None:
        views = self.views()
        before = views.images.clone()
        self.edit(views)
        fix = "do not write into views.images; work on a copy"
        self.require_equal("edit() changed the photos it was given", views.images, before, fix)

    def test_pixels_outside_the_masks_stay_after_the_composite(self) -> None:
        """The framework blends the edit into the photos by the masks; the editor must accept them and keep the size."""
        views = self.views()
        masks = torch.zeros(*views.images.shape[:2], *views.image_size, device=self.device)
        masks[..., : views.image_size[0] // 2, :] = 1
        edited = self.edit(views, masks=masks)
        self.require_tensor("images edited under masks", edited.images, tuple(views.images.shape))
        blended = composite(views.images, edited.images, masks)
        outside = masks[:, :, None].expand_as(blended) == 0
        fix = "return finite images of the size given"
        self.require_equal("pixels outside the masks changed", blended[outside], views.images[outside], fix)

    def _view_limits(self) -> tuple[int, int]:
        """Least and most views the declaration allows; 8 stands for any number."""
        if self.offer is None:
            return 1, 8
        return self.offer.component.min_views, self.offer.component.max_views or 8
