"""Contracts of what makes the scene from images: matcher, reconstructor and refiner."""

import math
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import Edit3rError, MatchingError
from edit3r.contract.interfaces import (
    Backbone,
    FindsGeometry,
    Geometry,
    Matcher,
    Reconstructor,
    RefineInputs,
    Refiner,
)
from edit3r.contract.types import PER_GAUSSIAN, Gaussians, Reconstruction, Views
from edit3r.kit import asking
from edit3r.kit.geometry.cameras import pixel_scales, pixels_to_gaussians
from edit3r.kit.geometry.rotations import rotation_angle
from edit3r.kit.weights.files import WEIGHTS, save_weights
from edit3r_testing.contract import Contract
from edit3r_testing.network import require_gradients
from edit3r_testing.rasterizer import reference_rasterizer
from edit3r_testing.scenes import Photographed, true_geometry

FRAME = "express poses and Gaussians in the frame of view 0 (geometry.cameras.relative_to_first)"


class MatcherContract(Contract):
    """Poses in the frame of view 0, positive depths, an easy scene placed right."""

    kind = "matcher"
    subject: Matcher
    image_size = (192, 256)
    max_angle: float = 0.1  # [radians] rotation error allowed on the easy scene

    def test_geometry_is_valid(self) -> None:
        self._match(self.scene(3).views)

    def test_an_easy_scene_is_placed_right(self) -> None:
        scene = self.scene()
        geometry = self._match(scene.views)
        found, true = geometry.c2w[0, 1], scene.cameras.c2w[0, 1]
        angle = rotation_angle(found[:3, :3], true[:3, :3]).item()
        self.require(
            angle < self.max_angle,
            f"the rotation is off by {math.degrees(angle):.1f} of "
            f"{math.degrees(self.max_angle):.1f} degrees.",
        )
        moved, truly = found[:3, 3], true[:3, 3]
        self.require(
            torch.cosine_similarity(moved, truly, dim=0) > 0.9,
            "the second camera stands on the wrong side; the last column of c2w is its place in "
            "the axes of view 0 (x right, y down, z forward).",
        )
        depths = scene.depths[0, 0]
        error = _depth_error(geometry.depths[0, 0], depths)
        flat = _depth_error(torch.ones_like(depths), depths)
        fix = "return camera z in the unit of the poses, not distance or disparity"
        self.require(
            error < 0.5 * flat,
            f"depths are off by {error:.0%}, a flat wall would be by {flat:.0%}; {fix}.",
        )
        unit = (geometry.depths[0, 0] / depths).median() * truly.norm() / moved.norm()
        self.require(
            0.5 < unit < 2,
            f"depths are in a unit of their own, {unit:.2g} times that of the poses; {fix}.",
        )

    def test_photos_without_texture_raise_a_matching_error(self) -> None:
        views = self.scene().views
        matched = _of_grey(self, views, self.subject.match, MatchingError)
        self.require(
            matched is None,
            "grey photos were matched; raise edit3r.contract.errors.MatchingError instead of "
            "inventing a pose.",
        )

    def _match(self, views: Views) -> Geometry:
        return self.ask(asking.find_geometry, views)


def _depth_error(
    depths: Float[Tensor, "*shape"], true: Float[Tensor, "height width"]
) -> float:
    """Mean relative error after the best common scale; an outlier counts as at most 100 %."""
    ratio = depths / true
    return (ratio / ratio.median() - 1).abs().clamp(max=1).mean().item()


def _require_origin(
    contract: Contract, c2w: Float[Tensor, "1 view 4 4"], atol: float
) -> None:
    origin = torch.eye(4, device=c2w.device)
    what = "the pose of view 0 is not the identity"
    contract.require_equal(what, c2w[0, 0], origin, FRAME, atol)


def _of_grey(
    contract: Contract,
    views: Views,
    function: Callable[[Views], Any],
    refusal: type[Edit3rError],
) -> Any:
    """What `function` makes of photos without texture; None where it refuses them."""
    grey = Views(torch.full_like(views.images, 0.5), views.intrinsics)
    try:
        with torch.no_grad():
            return function(grey)
    except refusal:
        return None
    except Exception as error:
        contract.require(
            False,
            f"grey photos raised {type(error).__name__}: {error}; raise "
            "edit3r.contract.errors.MatchingError.",
        )


class ReconstructorContract(Contract):
    """Valid Gaussians of scenes that do not mix; a network can be trained and saved."""

    kind = "reconstructor"
    subject: Reconstructor
    image_size = (96, 128)  # large enough for features to match
    # relative; convolutions and matrix products of another size round differently
    batch_tolerance: float = 1e-4
    # settings that training needs, over `settings`
    trained_with: ClassVar[Mapping[str, Any]] = {}

    def reconstruct(
        self,
        views: Views,
        source: Views | None = None,
        subject: Reconstructor | None = None,
    ) -> Reconstruction:
        """One reconstruction, without gradients, that keeps what the pipeline checks."""
        given = (views, source, self.geometry(views), views.image_size)
        asked = subject or self.subject
        with torch.no_grad():
            return self.ask(
                asking.reconstruct, views, lambda: asked(*given), subject=asked
            )

    def geometry(self, views: Views) -> Geometry | None:
        """The true one of the test photos, where the reconstructor uses any."""
        return true_geometry(views) if self.subject.uses_geometry else None

    def test_gaussians_are_valid_and_finite(self) -> None:
        self.reconstruct(self._views())

    def test_geometry_of_its_own_is_valid(self) -> None:
        """Of one that finds it by itself: what runs select by and level exposure with."""
        if not isinstance(self.subject, FindsGeometry):
            return
        views = self._views()
        self.ask(asking.find_geometry, views)

    def test_source_photos_are_accepted(self) -> None:
        """With the photos before editing beside; they are what geometry is best read from."""
        source = self._views()
        self.reconstruct(Views(1 - source.images, source.intrinsics), source)

    def test_predicted_cameras_are_poses_of_the_views(self) -> None:
        views = self._views()
        cameras = self.reconstruct(views).cameras
        if cameras is None:
            return
        self.require_tensor("cameras.c2w", cameras.c2w, (1, views.count, 4, 4))
        self.require(
            tuple(cameras.image_size) == views.image_size,
            f"cameras.image_size is {cameras.image_size} for photos of {views.image_size}; keep "
            "the photos' size.",
        )
        _require_origin(self, cameras.c2w, 1e-4)
        rotations = cameras.c2w[0, :, :3, :3]
        products = rotations @ rotations.transpose(-1, -2)
        unit = torch.eye(3, device=products.device).expand_as(products)
        self.require_equal("rotations are not orthonormal", products, unit, FRAME, 1e-3)

    def test_declared_limits_are_true(self) -> None:
        least, most = self.subject.min_views, self.subject.max_views
        self.reconstruct(self._views(least))
        if most is None or most > least:
            self.reconstruct(self._views(least + 1))

    def test_batch_items_are_independent(self) -> None:
        views = self._views(batch=2)
        together = self.reconstruct(views).gaussians
        fix = (
            "no statistic may be taken across scenes: use LayerNorm or eval-mode BatchNorm, and "
            "loop over scenes"
        )
        for item in range(2):
            alone = _item(self.reconstruct(views.scene(item)).gaussians, 0)
            part = _item(together, item)
            what = f"scene {item} of a batch differs from it alone"
            self.require_equal(what, part, alone, fix, self.batch_tolerance)

    def test_same_photos_give_the_same_result(self) -> None:
        views = self._views()
        fix = (
            "seed what is random (RANSAC, sampling) from the settings, and switch dropout off "
            "with .eval()"
        )
        self.require_same_twice(
            lambda: self.reconstruct(views).gaussians, "photos", fix
        )

    def test_leaves_its_inputs_alone(self) -> None:
        views = self._views()
        self.require_untouched(views.images, lambda: self.reconstruct(views))

    def test_photos_without_texture_end_in_a_result_or_a_sentence(self) -> None:
        """Grey photos may be refused with an Edit3rError, never with a traceback or NaN."""
        views = self._views()
        geometry = self.geometry(views)
        result = _of_grey(
            self, views, lambda v: self.subject(v, v, geometry), Edit3rError
        )
        if result is not None:
            self.call(asking.reconstruct, self.subject, views, lambda: result)

    def test_checkpoint_round_trip(self) -> None:
        """The network's state_dict in a fresh component of the same settings gives the same."""
        network = self.subject.network
        if network is None:
            return
        fresh = self.build()
        saved = {key: value.clone() for key, value in network.state_dict().items()}
        load = fresh.network.load_state_dict
        self.call(load, saved)
        fix = "register everything the result depends on as parameters or buffers of network"
        what = "a checkpoint put into a fresh component differs"
        self._require_same_of(fresh, self.subject, what, fix)

    def test_a_step_of_training_reaches_the_network(self) -> None:
        """In training mode gradients arrive, and what was trained is still valid."""
        subject = self._trained()
        if subject is not None:
            self.reconstruct(self._views(), subject=subject)

    def test_trained_weights_load_by_the_setting_weights(self) -> None:
        """What `edit3r train` saves of the network, given as `weights`, makes an equal one."""
        subject = self._trained()
        if subject is None or self.offer is None:  # settings are a component's
            return
        known = self.registry.settings_class(self.offer).model_fields
        fix = (
            "give its class a setting `weights` and fill the network by "
            "edit3r.kit.weights.files.load_weights"
        )
        self.require(
            "weights" in known, f"what is trained of it cannot be used; {fix}."
        )
        with tempfile.TemporaryDirectory() as folder:
            save_weights(Path(folder) / WEIGHTS, subject.network.state_dict())
            chosen = {**self.settings, **self.trained_with, "weights": folder}
            loaded = self.call(self.build_with, chosen)
            what = "loaded weights give another result"
            self._require_same_of(loaded, subject, what, fix)

    def _require_same_of(
        self, first: Reconstructor, second: Reconstructor, what: str, fix: str
    ) -> None:
        views = self._views()
        a, b = (
            self.reconstruct(views, subject=one).gaussians for one in (first, second)
        )
        self.require_equal(what, a, b, fix, self.tolerance)

    def _trained(self) -> Reconstructor | None:
        """A fresh component after one step of its network; None without a network."""
        if self.subject.network is None:
            return None
        subject = self.build()
        if self.trained_with:
            subject = self.build_with({**self.settings, **self.trained_with})
        network = subject.network
        views = self._views()
        network.train()
        result = self.call(subject, views, views, self.geometry(views))
        outputs = [getattr(result.gaussians, name) for name in PER_GAUSSIAN]
        require_gradients(self, outputs, {}, network)
        for name, part in network.named_modules():
            if isinstance(part, Backbone):
                gradients = [one.grad for one in part.parameters()]
                moved = any(one is not None and one.any() for one in gradients)
                self.require(
                    moved,
                    f"no gradient arrives in the backbone {name!r}; do not detach its features.",
                )
        torch.optim.SGD(network.parameters(), lr=1e-3).step()
        network.eval()
        return subject

    def _views(self, count: int | None = None, batch: int = 1) -> Views:
        return self.scene(count or max(2, self.subject.min_views), batch).views


def _item(gaussians: Gaussians, item: int) -> Gaussians:
    """A scene of a batch, without the transparent Gaussians that even out a batch's counts."""
    own = {name: getattr(gaussians, name)[item : item + 1] for name in PER_GAUSSIAN}
    scene = Gaussians(**own, view_index=gaussians.view_index)
    return scene.select(scene.opacities[0] > 0)


class RefinerContract(Contract):
    """Valid Gaussians in the same frame, which show what they showed; inputs stay."""

    kind = "refiner"
    subject: Refiner
    image_size = (24, 32)
    # mean difference allowed between images before and after, from the same cameras
    largest_change: float = 0.1

    def refine(
        self,
        scene: Photographed,
        masks: Float[Tensor, "1 view height width"] | None = None,
    ) -> Gaussians:
        """One refinement of the Gaussians on the surfaces of `scene`, edited to be brighter."""
        before = _on_surfaces(scene)
        edited = _brighter(before)
        inputs = self._inputs(scene, before, masks)
        return self.ask(asking.refine, edited, inputs)

    def test_refined_gaussians_are_valid(self) -> None:
        for count in (2, 3):
            self.refine(self.scene(count))

    def test_masks_of_the_edit_are_accepted(self) -> None:
        scene = self.scene()
        masks = torch.zeros_like(scene.views.images[:, :, 0])
        masks[..., : self.image_size[1] // 2] = 1
        self.refine(scene, masks)

    def test_the_scene_stays_in_its_frame(self) -> None:
        """Seen from the same cameras, it looks nearly as before."""
        scene = self.scene()
        render = reference_rasterizer().render
        before = render(_brighter(_on_surfaces(scene)), scene.cameras).images
        after = render(self.refine(scene), scene.cameras).images
        far = (before - after).abs().mean().item()
        fix = "keep positions in the frame of view 0 and the unit of the cameras"
        self.require(
            far < self.largest_change,
            f"images of the refined scene differ by {far:.3g} on average; {fix}.",
        )

    def test_same_input_gives_the_same_result(self) -> None:
        fix = "draw from a torch.Generator seeded by inputs.seed or the settings"
        self.require_same_twice(lambda: self.refine(self.scene()), "input", fix)

    def test_leaves_its_inputs_alone(self) -> None:
        scene = self.scene()
        given = _on_surfaces(scene)
        inputs = self._inputs(scene, given, None)
        images = scene.views.images
        self.require_untouched(images, lambda: self.subject(given, inputs))
        fix = "work on a copy, dataclasses.replace(gaussians, ...)"
        what = "the Gaussians it was given changed"
        self.require_equal(what, given, _on_surfaces(scene), fix)

    def _inputs(
        self,
        scene: Photographed,
        before: Gaussians,
        masks: Float[Tensor, "1 view height width"] | None,
    ) -> RefineInputs:
        rasterizer = reference_rasterizer()
        return RefineInputs(
            scene.cameras, scene.views, rasterizer, masks, before, seed=3
        )


def _brighter(gaussians: Gaussians) -> Gaussians:
    return replace(gaussians, harmonics=gaussians.harmonics + 0.2)


def _on_surfaces(scene: Photographed) -> Gaussians:
    """One Gaussian per pixel of a scene, where its ray meets the surface, in its colour."""
    images = scene.views.images
    depths = scene.depths.to(images)
    scales = pixel_scales(depths, scene.cameras.intrinsics, 0.6)
    opacities = torch.full_like(depths, 0.8)
    return pixels_to_gaussians(images, depths, scene.cameras, scales, opacities)
