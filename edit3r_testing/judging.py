"""Contract of a critic."""

from dataclasses import replace
from typing import Any

import torch

from edit3r.contract.instructions import Instruction, Target
from edit3r.contract.interfaces import Critic, EditToJudge, SceneToJudge, Selected
from edit3r.contract.types import Rendering, Views
from edit3r.contract.verdicts import LABELS, EditVerdict, Verdict
from edit3r.kit import asking
from edit3r_testing.contract import Contract
from edit3r_testing.scenes import gaussian_cloud, true_geometry

PLACED = (True, False, True)  # of the photos that were used
INSTRUCTION = Instruction("other", Target("marked"))


class CriticContract(Contract):
    """Verdicts that hold together, and that tell a failure from a success."""

    kind = "critic"
    subject: Critic
    image_size = (72, 96)

    def edit_to_judge(self, strength: float = 0.8, masked: bool = True) -> EditToJudge:
        """The first ball of three photos painted red, as far as `strength` goes."""
        scene = self.scene(3)
        masks = scene.objects[0] if masked else torch.ones_like(scene.objects[0])
        red = torch.tensor([1.0, 0.0, 0.0], device=self.device)[:, None, None]
        weight = strength * masks[:, :, None]
        images = scene.views.images * (1 - weight) + red * weight
        found = Selected(masks[0, :, None], ("marked", "geometry", "geometry"))
        return EditToJudge(
            before=scene.views,
            after=replace(scene.views, images=images),
            edited=range(3),
            instructions=(INSTRUCTION,),
            selected=(found,) if masked else (),
            masks=masks if masked else None,
            regions=masks[None] if masked else None,
        )

    def scene_to_judge(self, error: float = 0.01, known: bool = True) -> SceneToJudge:
        """Three photos, the second of which has no place, and a scene that misses by `error`."""
        photos = self.scene(3).views
        used = [view for view, there in enumerate(PLACED) if there]
        edited = photos.select(used)
        rendered = self._rendered(edited, error)
        return SceneToJudge(
            photos=photos,
            placed=PLACED,
            geometry=self._geometry(photos) if known else None,
            edited=edited,
            cameras=self.scene(3).cameras.select(used),
            gaussians=gaussian_cloud(len(used)),
            first=rendered,
            rendered=rendered,
            measured=torch.full((1, len(used)), 0.9).to(photos.images)
            if known
            else None,
        )

    def test_an_edit_is_judged_in_2d_and_again_in_3d(self) -> None:
        """Without masks too, and of the first photo alone."""
        edit = self.edit_to_judge()
        in_2d = self._judge_edit(edit)
        cameras = self.scene(3).cameras
        rendered = self._rendered(edit.after, 0.01)
        self._judge_edit(replace(edit, in_2d=in_2d, rendered=rendered, cameras=cameras))
        self._judge_edit(self.edit_to_judge(masked=False))
        self._judge_edit(replace(edit, edited=range(1)))

    def test_an_edit_that_changed_nothing_is_doubtful(self) -> None:
        label = self._judge_edit(self.edit_to_judge(0.0)).label
        self.require(
            label == "doubtful",
            f"photos that came back as they were are a {label} edit; call them doubtful.",
        )

    def test_a_verdict_has_an_entry_for_each_photo(self) -> None:
        """None for one that could not be placed; all else finite, and shares in [0, 1]."""
        for known in (True, False):
            self._judge_scene(self.scene_to_judge(known=known))

    def test_a_scene_that_shows_other_pictures_is_worse(self) -> None:
        right, wrong = (
            self._judge_scene(self.scene_to_judge(error)).label for error in (0.01, 0.6)
        )
        self.require(
            LABELS.index(wrong) > LABELS.index(right),
            f"a scene that shows its photos is {right}, one that does not is {wrong}; compare "
            "`rendered` with `edited`.",
        )

    def test_same_run_gives_the_same_verdict(self) -> None:
        """Nothing is drawn at random that the next judgement would not draw."""
        edit, scene = self.edit_to_judge(), self.scene_to_judge()
        first = self._judge_edit(edit), self._judge_scene(scene)
        torch.rand(3)
        self.require(
            first == (self._judge_edit(edit), self._judge_scene(scene)),
            "the same run was judged in two ways; seed what is random from the settings.",
        )

    def test_leaves_its_inputs_alone(self) -> None:
        edit, scene = self.edit_to_judge(), self.scene_to_judge()
        tensors = {
            "after": edit.after.images,
            "masks": edit.masks,
            "edited": scene.edited.images,
            "rendered": scene.rendered.images,
        }
        before = {name: tensor.clone() for name, tensor in tensors.items()}
        self._judge_edit(edit)
        self._judge_scene(scene)
        for name, tensor in tensors.items():
            what = f"`{name}` was changed"
            self.require_equal(what, tensor, before[name], "work on a copy")

    def _judge_edit(self, edit: EditToJudge) -> EditVerdict:
        return self.ask(asking.judge_edit, edit)

    def _judge_scene(self, scene: SceneToJudge) -> Verdict:
        return self.ask(asking.judge_scene, scene)

    def _rendered(self, views: Views, error: float) -> Rendering:
        """The views with a checkerboard of `error` on them."""
        images = views.images
        height, width = images.shape[-2:]
        rows, columns = torch.arange(height), torch.arange(width)
        board = ((rows[:, None] // 8 + columns // 8) % 2 * 2 - 1).to(images)
        alphas = torch.ones_like(images[:, :, :1])
        return Rendering((images + error * board).clamp(min=0), alphas, 3 * alphas)

    def _geometry(self, photos: Views) -> Any:
        geometry = true_geometry(photos)
        registered = torch.tensor([PLACED], device=self.device)
        return replace(geometry, registered=registered)
