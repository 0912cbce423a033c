"""Contracts of what makes the scene from images: matcher, reconstructor and refiner."""

import math
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from edit3r.contract.interfaces import (
    Backbone,
    MatchedGeometry,
    Matcher,
    Reconstructor,
    RefineInputs,
    Refiner,
)
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Views
from edit3r.errors import Edit3rError, MatchingError
from edit3r.geometry.cameras import pixel_scales, pixels_to_gaussians
from edit3r.geometry.rotations import rotation_angle
from edit3r.io.weight_files import WEIGHTS, save_weights
from edit3r_testing.contract import (
    GAUSSIAN_FIELDS,
    Contract,
    require_same_gaussians,
    require_valid_gaussians,
)
from edit3r_testing.network import backward, require_finite_gradients
from edit3r_testing.rasterizer import reference_rasterizer
from edit3r_testing.scenes import Photographed, photograph


class MatcherContract(Contract):
    """Poses in the frame of view 0, positive depths, confidences in [0, 1]; an easy scene is placed
    right.
    """

    kind = "matcher"
    subject: Matcher
    image_size: tuple[int, int] = (192, 256)  # (height, width) [pixels]
    max_angle: float = 0.1  # [radians] rotation error allowed on the easy scene

    def test_geometry_is_valid(self) -> None:
        views = photograph(3, self.image_size).views.to(self.device)
        geometry = self._match(views)
        height, width = views.image_size
        self.require_tensor("c2w", geometry.c2w, (1, 3, 4, 4))
        self.require_tensor("depths", geometry.depths, (1, 3, height, width))
        self.require_tensor("confidence", geometry.confidence, (1, 3, height, width))
        self.require_tensor("registered", geometry.registered, (1, 3), torch.bool)
        self.require(
            geometry.depths.min() > 0,
            "a depth is not positive; fill in where nothing matched.",
        )
        self.require_range(
            "confidence", geometry.confidence, 0, 1, "scale it; 0 means filled in"
        )
        identity = torch.eye(4, device=self.device)
        fix = "express poses in the frame of view 0"
        self.require_equal(
            "the pose of view 0 is not the identity",
            geometry.c2w[0, 0],
            identity,
            fix,
            1e-5,
        )
        self.require(
            geometry.registered[0, 0],
            "view 0 is not registered; everything is placed relative to it.",
        )

    def test_an_easy_scene_is_placed_right(self) -> None:
        scene = photograph(2, self.image_size)
        geometry = self._match(scene.views.to(self.device))
        found, true = geometry.c2w[0, 1].cpu(), scene.cameras.c2w[0, 1]
        angle = rotation_angle(found[:3, :3], true[:3, :3]).item()
        limit = math.degrees(self.max_angle)
        self.require(
            angle < self.max_angle,
            f"the rotation is off by {math.degrees(angle):.1f} of {limit:.1f} degrees.",
        )
        error, flat = (
            _depth_error(d, scene.depths[0, 0])
            for d in (geometry.depths[0, 0].cpu(), torch.ones(1))
        )
        fix = "return camera z in the unit of the poses, not distance or disparity"
        self.require(
            error < 0.5 * flat,
            f"depths are off by {error:.0%}, a flat wall would be by {flat:.0%}; {fix}.",
        )

    def test_photos_without_texture_raise_a_matching_error(self) -> None:
        views = photograph(2, self.image_size).views.to(self.device)
        try:
            self.subject.match(
                Views(torch.full_like(views.images, 0.5), views.intrinsics)
            )
        except MatchingError:
            return
        except Exception as error:
            self.require(
                False,
                f"grey photos raised {type(error).__name__}: {error}; raise "
                "edit3r.errors.MatchingError.",
            )
        self.require(
            False,
            "grey photos were matched; raise edit3r.errors.MatchingError instead of inventing a "
            "pose.",
        )

    def _match(self, views: Views) -> MatchedGeometry:
        geometry = self.call("match()", self.subject.match, views)
        self.require_type(
            "match() returned", geometry, MatchedGeometry, "MatchedGeometry"
        )
        return geometry


def _depth_error(
    depths: Float[Tensor, "*shape"], true: Float[Tensor, "height width"]
) -> float:
    """Mean relative error after the best common scale; an outlier counts as at most 100 %."""
    ratio = depths / true
    return (ratio / ratio.median() - 1).abs().clamp(max=1).mean().item()


class ReconstructorContract(Contract):
    """Valid, finite Gaussians; batch items independent; declared limits true; a network can be
    trained and saved.
    """

    kind = "reconstructor"
    subject: Reconstructor
    image_size: tuple[int, int] = (
        96,
        128,
    )  # (height, width) [pixels]; large enough for features to match
    # relative; convolutions and matrix products of another size round differently
    batch_tolerance: float = 1e-4
    trained_with: ClassVar[
        Mapping[str, Any]
    ] = {}  # settings that training needs, over `settings`

    def reconstruct(
        self,
        views: Views,
        source: Views | None = None,
        subject: Reconstructor | None = None,
    ):
        """One reconstruction without gradients."""
        batch, count, _, height, width = views.images.shape
        what = f"reconstructing {batch} x {count} photos of {height}x{width}"
        with torch.no_grad():
            result = self.call(
                what,
                subject or self.subject,
                views,
                source,
                views.image_size,
            )
        self.require_type("it returned", result, Reconstruction, "Reconstruction")
        return result

    def test_gaussians_are_valid_and_finite(self) -> None:
        views = self._views()
        require_valid_gaussians(self, self.reconstruct(views).gaussians, 1, views.count)

    def test_source_photos_are_accepted(self) -> None:
        """With the photos before editing beside; they are what geometry is best read from."""
        source = self._views()
        edited = Views(1 - source.images, source.intrinsics)
        require_valid_gaussians(
            self, self.reconstruct(edited, source).gaussians, 1, source.count
        )

    def test_predicted_cameras_are_poses_of_the_views(self) -> None:
        views = self._views()
        cameras = self.reconstruct(views).cameras
        if cameras is None:
            return
        self.require_type("cameras is", cameras, Cameras, "edit3r.Cameras or None")
        self.require_tensor("cameras.c2w", cameras.c2w, (1, views.count, 4, 4))
        self.require(
            tuple(cameras.image_size) == views.image_size,
            f"cameras.image_size is {cameras.image_size} for photos of {views.image_size}; keep "
            "the photos' size.",
        )
        first = torch.eye(4, device=cameras.c2w.device)
        fix = "express Gaussians and cameras in the frame of view 0, see edit3r.geometry.cameras.relative_to_first"
        self.require_equal(
            "the pose of view 0 is not the identity",
            cameras.c2w[0, 0],
            first,
            fix,
            1e-4,
        )
        rotations = cameras.c2w[0, :, :3, :3]
        products = rotations @ rotations.transpose(-1, -2)
        self.require_equal(
            "rotations are not orthonormal",
            products,
            first[:3, :3].expand_as(products),
            fix,
            1e-3,
        )

    def test_declared_limits_are_true(self) -> None:
        least, most = self._limits()
        if self.offer is not None:
            declared = (self.offer.component.min_views, self.offer.component.max_views)
            said = (self.subject.min_views, self.subject.max_views)
            self.require(
                declared == said or declared == (1, None),
                f"the declaration says min_views, max_views = {declared}, the object says "
                f"{said}; make them agree.",
            )
        for count in sorted({least, min(most or least + 1, least + 1)}):
            views = self._views(count)
            require_valid_gaussians(self, self.reconstruct(views).gaussians, 1, count)

    def test_batch_items_are_independent(self) -> None:
        views = self._views(batch=2)
        together = self.reconstruct(views).gaussians
        for item in range(2):
            alone = self.reconstruct(views.scene(item)).gaussians
            alone, part = _item(alone, 0), _item(together, item)
            fix = "no statistic may be taken across scenes: use LayerNorm or eval-mode BatchNorm, and loop over scenes"
            require_same_gaussians(
                self,
                f"scene {item} of a batch differs from it alone",
                part,
                alone,
                fix,
                self.batch_tolerance,
            )

    def test_same_photos_give_the_same_result(self) -> None:
        views = self._views()
        first = self.reconstruct(views).gaussians
        torch.rand(3)
        second = self.reconstruct(views).gaussians
        fix = "seed what is random (RANSAC, sampling) from the settings, and switch dropout off with .eval()"
        require_same_gaussians(
            self, "the same photos gave two results", second, first, fix, self.tolerance
        )

    def test_leaves_its_inputs_alone(self) -> None:
        views = self._views()
        before = views.images.clone()
        self.reconstruct(views)
        fix = "do not write into views.images; work on a copy"
        self.require_equal("the photos were changed", views.images, before, fix)

    def test_photos_without_texture_end_in_a_result_or_a_sentence(self) -> None:
        """Grey photos may be refused with an Edit3rError (such as MatchingError), never with a
        traceback or NaN.
        """
        views = self._views()
        grey = Views(torch.full_like(views.images, 0.5), views.intrinsics)
        try:
            with torch.no_grad():
                result = self.subject(grey)
        except Edit3rError:
            return
        except Exception as error:
            self.require(
                False,
                f"grey photos raised {type(error).__name__}: {error}; raise "
                "edit3r.errors.MatchingError.",
            )
        require_valid_gaussians(self, result.gaussians, 1, views.count)

    def test_checkpoint_round_trip(self) -> None:
        """The network's state_dict, put into a fresh component of the same settings, gives the same
        Gaussians.
        """
        network = self.subject.network
        if network is None:
            return
        self.require_type("network is", network, nn.Module, "an nn.Module or None")
        views = self._views()
        before = self.reconstruct(views).gaussians
        fresh = self.build()
        saved = {key: value.clone() for key, value in network.state_dict().items()}
        self.call(
            "loading its own state_dict into a fresh one",
            fresh.network.load_state_dict,
            saved,
        )
        after = self.reconstruct(views, subject=fresh).gaussians
        fix = "register everything the result depends on as parameters or buffers of network"
        require_same_gaussians(
            self,
            "a checkpoint put into a fresh component differs",
            after,
            before,
            fix,
            self.tolerance,
        )

    def test_a_step_of_training_reaches_the_network(self) -> None:
        """In training mode gradients arrive, in every backbone too, and what was trained is still
        valid.
        """
        subject = self._trained()
        if subject is None:
            return
        views = self._views()
        require_valid_gaussians(
            self, self.reconstruct(views, subject=subject).gaussians, 1, views.count
        )

    def test_trained_weights_load_by_the_setting_weights(self) -> None:
        """What `edit3r train` saves of the network, given as `weights`, makes an equal
        reconstructor.
        """
        subject = self._trained()
        if subject is None or self.offer is None:  # settings are a component's
            return
        known = self.registry.settings_class(self.offer).model_fields
        fix = "give its class a setting `weights` and fill the network by edit3r.io.weight_files.load_weights"
        self.require(
            "weights" in known, f"what is trained of it cannot be used; {fix}."
        )
        views = self._views()
        before = self.reconstruct(views, subject=subject).gaussians
        with tempfile.TemporaryDirectory() as folder:
            save_weights(Path(folder) / WEIGHTS, subject.network.state_dict())
            chosen = {**self.settings, **self.trained_with, "weights": folder}
            loaded = self.call("building it with weights", self._built_with, chosen)
            after = self.reconstruct(views, subject=loaded).gaussians
        require_same_gaussians(
            self,
            "loaded weights give another result",
            after,
            before,
            fix,
            self.tolerance,
        )

    def _trained(self) -> Reconstructor | None:
        """A fresh component after one step of its network; None without a network."""
        if self.subject.network is None:
            return None
        chosen = {**self.settings, **self.trained_with}
        subject = self._built_with(chosen) if self.trained_with else self.build()
        network, views = subject.network, self._views()
        network.train()
        gaussians = self.call(
            "reconstructing in training mode", subject, views, views
        ).gaussians
        backward(self, [getattr(gaussians, name) for name in GAUSSIAN_FIELDS])
        require_finite_gradients(self, dict(network.named_parameters()))
        for name, part in network.named_modules():
            if isinstance(part, Backbone):
                moved = any(
                    p.grad is not None and bool(p.grad.abs().max() > 0)
                    for p in part.parameters()
                )
                self.require(
                    moved,
                    f"no gradient arrives in the backbone {name!r}; do not detach its features.",
                )
        torch.optim.SGD(network.parameters(), lr=1e-3).step()
        network.eval()
        return subject

    def _built_with(self, settings: Mapping[str, Any]) -> Reconstructor:
        return self.registry.build(
            self.kind, self.component, dict(self.parts), **settings
        )

    def _limits(self) -> tuple[int, int | None]:
        return self.subject.min_views, self.subject.max_views

    def _views(self, count: int | None = None, batch: int = 1) -> Views:
        return photograph(
            count or max(2, self._limits()[0]), self.image_size, batch
        ).views.to(self.device)


def _item(gaussians: Gaussians, item: int) -> Gaussians:
    """Scene `item` of a batch, as a batch of one, without the transparent Gaussians that even out a
    batch's counts.
    """
    fields = {
        name: getattr(gaussians, name)[item : item + 1] for name in GAUSSIAN_FIELDS
    }
    scene = Gaussians(**fields, view_index=gaussians.view_index)
    return scene.select(scene.opacities[0] > 0)


class RefinerContract(Contract):
    """Valid Gaussians in the same frame, which show what they showed; inputs stay; the same inputs,
    the same result.
    """

    kind = "refiner"
    subject: Refiner
    image_size: tuple[int, int] = (24, 32)  # (height, width) [pixels]
    # mean difference allowed between images before and after, from the same cameras
    largest_change: float = 0.1

    def refine(
        self,
        scene: Photographed,
        masks: Float[Tensor, "1 view height width"] | None = None,
    ) -> Gaussians:
        """One refinement of the Gaussians that lie on the surfaces of `scene` (batch 1), edited to
        be brighter.
        """
        before = _on_surfaces(scene)
        edited = replace(before, harmonics=before.harmonics + 0.2)
        inputs = self._inputs(scene, masks, before)
        refined = self.call("refining", self.subject, edited, inputs)
        self.require_type("it returned", refined, Gaussians, "edit3r.Gaussians")
        return refined

    def test_refined_gaussians_are_valid(self) -> None:
        for count in (2, 3):
            require_valid_gaussians(self, self.refine(self._scene(count)), 1, count)

    def test_masks_of_the_edit_are_accepted(self) -> None:
        scene = self._scene()
        masks = torch.zeros(1, scene.views.count, *self.image_size, device=self.device)
        masks[..., : self.image_size[1] // 2] = 1
        require_valid_gaussians(self, self.refine(scene, masks), 1, scene.views.count)

    def test_the_scene_stays_in_its_frame(self) -> None:
        """Seen from the same cameras, it looks nearly as before."""
        scene = self._scene()
        given = _on_surfaces(scene)
        before = replace(given, harmonics=given.harmonics + 0.2)
        images = [
            self._rasterizer.render(g, scene.cameras).images
            for g in (before, self.refine(scene))
        ]
        far = (images[0] - images[1]).abs().mean().item()
        fix = "keep positions in the frame of view 0 and the unit of the cameras"
        self.require(
            far < self.largest_change,
            f"pictures of the refined scene differ by {far:.3g} on average; {fix}.",
        )

    def test_same_input_gives_the_same_result(self) -> None:
        first = self.refine(self._scene())
        torch.rand(
            3
        )  # a refiner that draws from the global generator would now draw something else
        second = self.refine(self._scene())
        fix = "draw from a torch.Generator seeded by inputs.seed or the settings"
        require_same_gaussians(
            self, "the same input gave two results", second, first, fix, self.tolerance
        )

    def test_leaves_its_inputs_alone(self) -> None:
        scene = self._scene()
        given, images = _on_surfaces(scene), scene.views.images.clone()
        self.call("refining", self.subject, given, self._inputs(scene, None, given))
        fix = "work on a copy, dataclasses.replace(gaussians, ...)"
        require_same_gaussians(
            self,
            "the Gaussians it was given changed",
            given,
            _on_surfaces(scene),
            fix,
            0.0,
        )
        self.require_equal("the photos changed", scene.views.images, images, fix)

    def _inputs(
        self,
        scene: Photographed,
        masks: Float[Tensor, "1 view height width"] | None,
        before: Gaussians,
    ) -> RefineInputs:
        return RefineInputs(
            scene.cameras, scene.views, self._rasterizer, masks, before, seed=3
        )

    @property
    def _rasterizer(self):
        return reference_rasterizer()

    def _scene(self, count: int = 2) -> Photographed:
        scene = photograph(count, self.image_size)
        return replace(
            scene,
            views=scene.views.to(self.device),
            cameras=scene.cameras.to(self.device),
        )


def _on_surfaces(scene: Photographed) -> Gaussians:
    """One Gaussian per pixel of a scene (batch 1), where the pixel's ray meets the surface, in the
    pixel's colour.
    """
    images = scene.views.images
    depths = scene.depths.to(images)
    scales = pixel_scales(depths, scene.cameras.intrinsics, 0.6)
    return pixels_to_gaussians(
        images, depths, scene.cameras, scales, torch.full_like(depths, 0.8)
    )
