"""Faults that strangers make, three for each kind of component: contract and run tell each in the
same sentence, which names the part at fault. The table FAULTS is the documentation.
"""

import re
from dataclasses import dataclass, replace
from typing import Any

import edit3r_segmenters.named
import pytest
import torch

import edit3r
from edit3r.cli import main as cli
from edit3r.contract.command import Command
from edit3r.contract.component import KINDS, Component, Offer
from edit3r.contract.errors import PluginError
from edit3r.contract.interfaces import (
    Backbone,
    Critic,
    Dataset,
    Detection,
    Detector,
    Editor,
    GaussianHead,
    Loss,
    MaskLogits,
    Matcher,
    Proposal,
    Rasterizer,
    Reader,
    Reconstructor,
    Refiner,
    Segmenter,
    Selected,
    Selection,
    Selector,
    Trainer,
    Writer,
)
from edit3r.contract.types import Cameras, Features, Reconstruction
from edit3r.contract.verdicts import EditVerdict, Verdict
from edit3r.kit.geometry.cameras import pixels_to_gaussians
from edit3r.running import usual_reader
from edit3r.running.components import Components
from edit3r_testing import (
    CONTRACTS,
    ContractViolation,
    TinyBackbone,
    claims,
    photograph,
)
from edit3r_testing.broken import BrokenReconstructor
from edit3r_testing.rasterizer import reference_rasterizer
from edit3r_testing.scenes import true_geometry
from edit3r_testing.training import _FormulaScenes, tiny_job


@dataclass
class Fault:
    """How a good answer is spoiled, and words of the sentence about it."""

    spoil: Any  # of the answer; an error is raised in place of it
    words: str
    method: str = ""  # of which; default: the kind's main one
    attributes: Any = None  # of the component

    def __call__(self, method, answer):
        if self.method in ("", method):
            if isinstance(self.spoil, Exception):
                raise self.spoil
            return self.spoil(answer)
        return answer


# ---- a good component of each kind, whose answers pass through a fault ----


def flat(images, intrinsics, view_index=None):
    """A Gaussian a pixel, three units away."""
    depths = torch.full_like(images[:, :, 0], 3.0)
    poses = torch.eye(4).expand(*images.shape[:2], 4, 4)
    cameras = Cameras(poses, intrinsics, images.shape[-2:])
    scales, opacities = depths / images.shape[-1], torch.full_like(depths, 0.6)
    return pixels_to_gaussians(images, depths, cameras, scales, opacities), cameras


class Good:
    """What every component here has."""

    def __init__(self, fault, kind):
        if isinstance(self, torch.nn.Module):
            torch.nn.Module.__init__(self)
        self.fault, self.settings = fault, edit3r.Settings()
        about = {}
        if kind == "writer":
            about = {"suffix": ".txt", "keeps": "nothing", "loses": "all"}
        self.offer = Offer(
            kind, Component("theirs", "no:No", "a test's", **about), "x", "1"
        )
        for name, value in (fault.attributes or {}).items():
            setattr(self, name, value)


class GoodReader(Good, Reader):
    def read(self, prompt):
        return self.fault("read", usual_reader().read(prompt))

    def read_target(self, words):
        return usual_reader().read_target(words)


class GoodEditor(Good, Editor):
    def edit(self, views, request):
        return self.fault("edit", replace(views, images=1 - views.images))

    def understands(self, instruction):
        return self.fault("understands", True)

    def widened(self, regions, images):
        return self.fault("widened", regions)


class GoodSegmenter(Good, Segmenter):
    def masks(self, image, clicks, box=None, before=None):
        return self.fault("masks", MaskLogits(torch.ones(1, 4, 6)))

    def words(self, image, text):
        return self.fault("words", (Proposal(torch.ones(image.shape[1:])),))


class GoodDetector(Good, Detector):
    def detect(self, image, text):
        return self.fault("detect", (Detection("ball", 0.7, (2.0, 2.0, 8.0, 8.0)),))


class GoodSelector(Good, Selector):
    def select(self, views, selection, geometry=None):
        masks = torch.ones(views.count, 1, *views.image_size)
        return self.fault("select", Selected(masks, ("marked",) * views.count))


class GoodMatcher(Good, Matcher):
    def match(self, views):
        return self.fault("match", true_geometry(views))


class GoodReconstructor(Good, Reconstructor):
    def __call__(self, views, source=None, geometry=None, grid=None):
        return self.fault("", Reconstruction(*flat(views.images, views.intrinsics)))


class GoodBackbone(Good, Backbone):
    def __init__(self, fault, kind):
        super().__init__(fault, kind)
        self.good, self.patch_size, self.feature_widths = (
            TinyBackbone(8),
            8,
            (12, 16, 20, 24),
        )

    def forward(self, images, intrinsics, geometry=None):
        return self.fault("forward", self.good(images, intrinsics))


class GoodHead(Good, GaussianHead):
    def __init__(self, fault, kind):
        super().__init__(fault, kind)
        self.gain = torch.nn.Parameter(torch.ones(()))

    def forward(self, features, images, source, geometry):
        return self.fault("forward", flat(self.gain * images, source.intrinsics)[0])


class GoodRasterizer(Good, Rasterizer):
    def render(self, gaussians, cameras):
        return self.fault("render", reference_rasterizer().render(gaussians, cameras))


class GoodRefiner(Good, Refiner):
    def __call__(self, gaussians, inputs):
        return self.fault("", gaussians)


class GoodCritic(Good, Critic):
    def judge_edit(self, edit):
        label = (
            "doubtful" if torch.equal(edit.before.images, edit.after.images) else "good"
        )
        return self.fault("judge_edit", EditVerdict(label, "so it is", {}))

    def judge_scene(self, scene):
        none = (None,) * len(scene.placed)
        verdict = Verdict("good", "so it is", none, none, scene.placed, *4 * (none,))
        return self.fault("judge_scene", verdict)


class GoodWriter(Good, Writer):
    def write(self, path, scene):
        self.fault("write", path)


class GoodLoss(Good, Loss):
    def __call__(self, inputs):
        return self.fault("", (inputs.rendered - inputs.target).square().mean())


class GoodDataset(Good, Dataset):
    def __len__(self):
        return 4

    def __getitem__(self, index):
        return self.fault("", _FormulaScenes()[index])


class GoodTrainer(Good, Trainer):
    def train(self, job):
        best = job.out / "best"
        best.mkdir(parents=True)
        (best / "weights").write_text("")
        return self.fault("train", best)


class GoodCommand(Good, Command):
    """A command."""

    def add_arguments(self, parser):
        self.fault("add_arguments", parser)

    def main(self, args):
        return 0


# ---- the faults ----


def images(change):
    return lambda answer: replace(answer, images=change(answer.images))


def scene(**changes):
    def spoil(answer):
        made = answer.gaussians
        fields = {name: change(getattr(made, name)) for name, change in changes.items()}
        return replace(answer, gaussians=replace(made, **fields))

    return spoil


def clear(answer):
    return replace(answer, masks=torch.zeros_like(answer.masks))


ZERO = ZeroDivisionError("division by zero")
RAISED = "raised ZeroDivisionError: division by zero."
FAULTS: dict[str, tuple[Fault, Fault, Fault]] = {
    "reader": (
        Fault(ZERO, RAISED),
        Fault(list, "must return tuple, got list"),
        Fault(lambda _: (), "must return an instruction, or raise PromptError"),
    ),
    "editor": (
        Fault(
            images(lambda x: 3 * x - 1),
            r"must return images in \[0, 1\], got -",
            "edit",
        ),
        Fault(ZERO, RAISED, "understands"),
        Fault(lambda x: x[0], "must return widened regions of shape", "widened"),
    ),
    "segmenter": (
        Fault(ZERO, RAISED),
        Fault(
            lambda _: MaskLogits(torch.ones(4, 6)),
            r"must return logits \[n, h, w\]",
            "masks",
        ),
        Fault(
            lambda x: (replace(x[0], confidence=7.0),),
            r"must return confidence in \[0, 1\], got 7.0",
            "words",
        ),
    ),
    "detector": (
        Fault(list, "must return tuple, got list"),
        Fault(
            lambda x: (replace(x[0], score=70.0),),
            r"must return score in \[0, 1\], got 70.0",
        ),
        Fault(
            lambda x: (replace(x[0], box=(20.0, 20.0, 900.0, 9.0)),),
            r"must return boxes \(x, y, width, height\) in pixels",
        ),
    ),
    "selector": (
        Fault(
            lambda x: replace(x, confidence=7.0),
            r"return confidence in \[0, 1\], got 7.0",
        ),
        Fault(
            lambda x: replace(x, masks=8 * x.masks), r"must return masks in \[0, 1\]"
        ),
        Fault(
            lambda x: replace(x, how=x.how[:1]),
            "must say how it was found on each view",
        ),
    ),
    "matcher": (
        Fault(
            lambda x: replace(x, depths=x.depths.clamp(min=1e30)),
            r"depths in a unit that keeps them from 1e-06 to 1e\+06, got 1e\+30",
        ),
        Fault(
            lambda x: replace(x, depths=1e-15 * x.depths),
            "depths in a unit that keeps them from",
        ),
        Fault(
            lambda x: tuple(x.depths),
            "must return edit3r.contract.interfaces.Geometry, got",
        ),
    ),
    "reconstructor": (
        Fault(scene(view_index=lambda x: x + 1), "must return view_index from -1 to"),
        Fault(scene(means=lambda x: x / 0), "returned means with"),
        Fault(
            lambda x: x.gaussians,
            "must return edit3r.contract.types.Reconstruction, got",
        ),
    ),
    "backbone": (
        Fault(ZERO, RAISED),
        Fault(lambda x: Features(x.levels[1:], x.grid), "as feature_widths say"),
        Fault(
            lambda x: x.levels, "must return edit3r.contract.types.Features, got tuple"
        ),
    ),
    "head": (
        Fault(ZERO, RAISED),
        Fault(lambda x: x.without_view(0), r"\(per_pixel\) of each pixel"),
        Fault(
            lambda x: replace(x, scales=-x.scales), "must return scales above 0, got -"
        ),
    ),
    "rasterizer": (
        Fault(images(lambda x: x[..., 1:]), "must return images of shape"),
        Fault(
            lambda x: replace(
                x,
                images=x.images.detach(),
                alphas=x.alphas.detach(),
                depths=x.depths.detach(),
            ),
            "must render differentiably",
        ),
        Fault(
            lambda x: replace(x, alphas=3 * x.alphas), r"must return alphas in \[0, 1\]"
        ),
    ),
    "refiner": (
        Fault(lambda x: x.select(torch.arange(0)), r"must leave some of \d+ Gaussians"),
        Fault(
            lambda x: replace(x, scales=0 * x.scales),
            "must return scales above 0, got 0",
        ),
        Fault(ZERO, RAISED),
    ),
    "critic": (
        Fault(ZERO, RAISED),
        Fault(
            lambda x: replace(x, measures={"error": float("nan")}),
            "must return measures that go into run.json",
            "judge_edit",
        ),
        Fault(
            lambda x: replace(x, label="superb"),
            "must label a scene good or fair or poor or failed",
            "judge_scene",
        ),
    ),
    "writer": (
        Fault(ZERO, RAISED),
        Fault(lambda path: None, "must write the file that it is given"),
        Fault(lambda path: path.mkdir(), "must write the file that it is given"),
    ),
    "loss": (
        Fault(ZERO, RAISED),
        Fault(lambda x: x.item(), "must return torch.Tensor, got float"),
        Fault(lambda x: x.detach(), "must carry gradients"),
    ),
    "dataset": (
        Fault(ZERO, RAISED),
        Fault(
            lambda x: replace(x, context=255 * x.context),
            r"must return context in \[0, 1\]",
        ),
        Fault(
            lambda x: replace(
                x,
                target_cameras=replace(
                    x.target_cameras, intrinsics=64 * x.target_cameras.intrinsics
                ),
            ),
            "must normalise the focal lengths of target_cameras",
        ),
    ),
    "trainer": (
        Fault(ZERO, RAISED),
        Fault(str, "must return pathlib.Path, got str"),
        Fault(
            lambda x: x.parent / "none",
            "must return the folder of a checkpoint in job.out",
        ),
    ),
    "command": (
        Fault(ZERO, RAISED),
        Fault(
            lambda x: x.add_argument("--debug", help="more", action="store_true"),
            "raised ArgumentError: argument --debug: conflicting option string",
        ),
        Fault(
            lambda x: x.add_argument("--sure", help="at most 50%)"), "raised ValueError"
        ),
    ),
}


# ---- the two ways ----


def told_by_the_contract(kind, component):
    """The first complaint of the kind's contract."""
    contract = CONTRACTS[kind]
    bound = type(
        "Bound", (contract,), {"build": lambda self: component, **SMALL.get(kind, {})}
    )
    for claim in claims(contract):
        try:
            getattr(bound(), claim)()
        except ContractViolation as violation:
            return str(violation)
    return "nothing"


SMALL = {
    "matcher": {"image_size": (24, 32)},
    "reconstructor": {"image_size": (24, 32)},
    "backbone": {"patches": (2, 2)},
    "editor": {"masked": True},
}


def good(kind):
    """One that keeps all promises."""
    return named()[kind](Fault(None, "", "-"), kind)


def named():
    """The class above of each kind."""
    return {
        cls.__name__.removeprefix("Good").lower(): cls for cls in Good.__subclasses__()
    }


def a_run(**parts):
    masks = torch.zeros(1, 2, 16, 24)
    masks[..., :8, :] = 1
    usual = {
        "prompt": "paint the wall red",
        "editor": good("editor"),
        "recon": good("reconstructor"),
        "frames": 2,
        "masks": masks,
    }
    return edit3r.run(photograph(2, (16, 24)).views, **{**usual, **parts})


def a_run_that_selects(**parts):
    mark = Selection(positive=((0, 0.4, 0.4),))
    return a_run(masks=mark, matcher=good("matcher"), **parts)


def a_run_with_words(component):
    """Words find the thing; without geometry, as nobody reads any."""
    return edit3r.select(
        photograph(2, (16, 24)).views, Selection(words="wall"), segmenter=component
    )


def a_run_of_refiners(component, monkeypatch):
    monkeypatch.setattr(Components, "refiners", (component,))
    return a_run()


def a_saved_run(component, monkeypatch, folder):
    monkeypatch.setattr(Components, "writer", lambda self, name: component)
    return a_run().save(folder)


def a_detection(component, monkeypatch):
    module = edit3r_segmenters.named
    monkeypatch.setattr(module, "_knowing", lambda text: "theirs")
    monkeypatch.setattr(module, "build", lambda *name: component)
    image = photograph(2, (16, 24)).views.images[0, 0]
    return module.named(image, "ball", good("segmenter"))


def network(**parts):
    parts = {"backbone": TinyBackbone(8), "head": good("head"), **parts}
    return edit3r.build("reconstructor", "edit3r", parts, weights="untrained")


def a_training(folder, **changes):
    off = {"colour": 0, "depth": 0, "opacity": 0}
    trainer = edit3r.build("trainer", "recolor", steps=1, batch=1, warmup=1, **off)
    return trainer.train(replace(tiny_job(folder), **changes))


def a_train_command(component, monkeypatch, folder):
    prepared = component, tiny_job(folder / "out")
    module = "edit3r_training.job.prepare"
    monkeypatch.setattr(module, lambda *given, **more: prepared)
    monkeypatch.setattr("edit3r.kit.files.configs.read_config", lambda *given: {})
    command = edit3r.build("command", "train")
    parser = cli.parser_of(command, "train")
    return command.main(cli.parse(parser, ["a.yaml", "--quiet"]))


def a_command(component, monkeypatch):
    monkeypatch.setattr(cli, "find_command", lambda name: component)
    told: list[str] = []
    monkeypatch.setattr(cli, "_tell", told.append)
    assert cli.main(["theirs", "--help"]) == 2
    raise PluginError(told[0])


def told_by_a_run(kind, one, patch, folder):
    """What a run says of it, or the command that asks it."""
    ways = {
        "segmenter": lambda: (
            a_run_with_words(one)
            if one.fault.method == "words"
            else a_run_that_selects(segmenter=one)
        ),
        "selector": lambda: a_run_that_selects(selector=one),
        "matcher": lambda: a_run(matcher=one, recon=BrokenReconstructor()),
        "reconstructor": lambda: a_run(recon=one),
        "backbone": lambda: a_run(recon=network(backbone=one)),
        "head": lambda: a_run(recon=network(head=one)),
        "refiner": lambda: a_run_of_refiners(one, patch),
        "writer": lambda: a_saved_run(one, patch, folder),
        "detector": lambda: a_detection(one, patch),
        "loss": lambda: a_training(folder, losses={"theirs": (1.0, one)}),
        "dataset": lambda: a_training(folder, train_data=one),
        "trainer": lambda: a_train_command(one, patch, folder),
        "command": lambda: a_command(one, patch),
    }
    with pytest.raises(PluginError) as error:
        ways.get(kind, lambda: a_run(**{kind: one}))()
    return str(error.value)


def same_but_for_numbers(sentence):
    return re.sub(r"\d[\d.e+-]*", "#", sentence)


CASES = [(kind, number) for kind in FAULTS for number in range(3)]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "number"), CASES)
def test_contract_and_run_tell_a_fault_in_one_sentence(
    kind, number, tmp_path, monkeypatch
):
    fault = FAULTS[kind][number]
    component = named()[kind](fault, kind)
    by_contract = told_by_the_contract(kind, component)
    by_run = told_by_a_run(kind, component, monkeypatch, tmp_path)
    assert by_run.startswith(f"{kind} 'theirs' of plugin 'x' "), by_run
    assert re.search(fault.words, by_run), by_run
    assert same_but_for_numbers(by_contract) == same_but_for_numbers(by_run)


def test_the_table_has_every_kind():
    assert set(FAULTS) == set(KINDS)
