"""Contract of a reconstructor."""

import torch
from torch import nn

from edit3r.errors import Edit3rError
from edit3r.interfaces import Reconstructor
from edit3r.testing.contract import Contract
from edit3r.testing.gaussians import require_same_gaussians, require_valid_gaussians
from edit3r.testing.scenes import photograph
from edit3r.types import Cameras, Gaussians, Reconstruction, Views


class ReconstructorContract(Contract):
    """Valid, finite Gaussians; batch items independent; declared limits true; checkpoints round trip."""

    kind = "reconstructor"
    subject: Reconstructor
    image_size: tuple[int, int] = (96, 128)  # (height, width) [pixels]; large enough for features to match
    batch_tolerance: float = 1e-4  # relative; convolutions and matrix products of another size round differently

    def reconstruct(self, views: Views, source: Views | None = None, subject: Reconstructor | None = None):
        """One reconstruction without gradients."""
        batch, count, _, height, width = views.images.shape
        what = f"reconstructing {batch} x {count} photos of {height}x{width}"
        with torch.no_grad():
            result = self.call(what, subject or self.subject, views, source)
        self.require(
            isinstance(result, Reconstruction), f"it returned a {type(result).__name__}; return Reconstruction."
        )
        return result

    def test_gaussians_are_valid_and_finite(self) -> None:
        views = self._views()
        require_valid_gaussians(self, self.reconstruct(views).gaussians, 1, views.count)

    def test_source_photos_are_accepted(self) -> None:
        """With the photos before editing beside; they are what geometry is best read from."""
        source = self._views()
        edited = Views(1 - source.images, source.intrinsics)
        require_valid_gaussians(self, self.reconstruct(edited, source).gaussians, 1, source.count)

    def test_predicted_cameras_are_poses_of_the_views(self) -> None:
        views = self._views()
        cameras = self.reconstruct(views).cameras
        if cameras is None:
            return
        self.require(
            isinstance(cameras, Cameras), f"cameras is a {type(cameras).__name__}; return edit3r.Cameras or None."
        )
        self.require_tensor("cameras.c2w", cameras.c2w, (1, views.count, 4, 4))
        self.require(
            tuple(cameras.image_size) == views.image_size,
            f"cameras.image_size is {cameras.image_size} for photos of {views.image_size}; keep the photos' size.",
        )
        first = torch.eye(4, device=cameras.c2w.device)
        fix = "express Gaussians and cameras in the frame of view 0, see edit3r.geometry.cameras.relative_to_first"
        self.require_equal("the pose of view 0 is not the identity", cameras.c2w[0, 0], first, fix, 1e-4)
        rotations = cameras.c2w[0, :, :3, :3]
        products = rotations @ rotations.transpose(-1, -2)
        self.require_equal("rotations are not orthonormal", products, first[:3, :3].expand_as(products), fix, 1e-3)

    def test_declared_limits_are_true(self) -> None:
        least, most = self._limits()
        if self.offer is not None:
            declared = (self.offer.component.min_views, self.offer.component.max_views)
            said = (self.subject.min_views, self.subject.max_views)
            self.require(
                declared == said or declared == (1, None),
                f"the declaration says min_views, max_views = {declared}, the object says {said}; make them agree.",
            )
        for count in sorted({least, min(most or least + 1, least + 1)}):
            views = self._views(count)
            require_valid_gaussians(self, self.reconstruct(views).gaussians, 1, count)

    def test_batch_items_are_independent(self) -> None:
        views = self._views(batch=2)
        together = self.reconstruct(views).gaussians
        for item in range(2):
            alone = self.reconstruct(Views(views.images[item : item + 1], views.intrinsics[item : item + 1])).gaussians
            alone, part = _item(alone, 0), _item(together, item)
            fix = "no statistic may be taken across scenes: use LayerNorm or eval-mode BatchNorm, and loop over scenes"
            require_same_gaussians(
                self, f"scene {item} of a batch differs from it alone", part, alone, fix, self.batch_tolerance
            )

    def test_same_photos_give_the_same_result(self) -> None:
        views = self._views()
        first = self.reconstruct(views).gaussians
        torch.rand(3)
        second = self.reconstruct(views).gaussians
        fix = "seed what is random (RANSAC, sampling) from the settings, and switch dropout off with .eval()"
        require_same_gaussians(self, "the same photos gave two results", second, first, fix, self.tolerance)

    def test_leaves_its_inputs_alone(self) -> None:
        views = self._views()
        before = views.images.clone()
        self.reconstruct(views)
        fix = "do not write into views.images; work on a copy"
        self.require_equal("the photos were changed", views.images, before, fix)

    def test_photos_without_texture_end_in_a_result_or_a_sentence(self) -> None:
        """Grey photos may be refused with an Edit3rError (such as MatchingError), never with a traceback or NaN."""
        views = self._views()
        grey = Views(torch.full_like(views.images, 0.5), views.intrinsics)
        try:
            with torch.no_grad():
                result = self.subject(grey)
        except Edit3rError:
            return
        except Exception as error:
            self.require(
                False, f"grey photos raised {type(error).__name__}: {error}; raise edit3r.errors.MatchingError."
            )
        require_valid_gaussians(self, result.gaussians, 1, views.count)

    def test_checkpoint_round_trip(self) -> None:
        """The network's state_dict, put into a fresh component of the same settings, gives the same Gaussians."""
        network = self.subject.network
        if network is None:
            return
        self.require(
            isinstance(network, nn.Module), f"network is a {type(network).__name__}; return an nn.Module or None."
        )
        views = self._views()
        before = self.reconstruct(views).gaussians
        fresh = self.build()
        saved = {key: value.clone() for key, value in network.state_dict().items()}
        self.call("loading its own state_dict into a fresh one", fresh.network.load_state_dict, saved)
        after = self.reconstruct(views, subject=fresh).gaussians
        fix = "register everything the result depends on as parameters or buffers of network"
        require_same_gaussians(
            self, "a checkpoint put into a fresh component differs", after, before, fix, self.tolerance
        )

    def _limits(self) -> tuple[int, int | None]:
        return self.subject.min_views, self.subject.max_views

    def _views(self, count: int | None = None, batch: int = 1) -> Views:
        return photograph(count or max(2, self._limits()[0]), self.image_size, batch).views.to(self.device)


def _item(gaussians: Gaussians, item: int) -> Gaussians:
    """Scene `item` of a batch, as a batch of one, without the transparent Gaussians that even out a batch's counts."""
    names = ("means", "scales", "quats", "opacities", "harmonics")
    fields = {name: getattr(gaussians, name)[item : item + 1] for name in names}
    scene = Gaussians(**fields, view_index=gaussians.view_index)
    return scene.select(scene.opacities[0] > 0)
