"""The interface of every kind of component.

Each concrete class has a nested `Settings` (a subclass of `edit3r.Settings`, every field with
default, range and description) and is constructed by the registry as `Class(settings, **parts)`.
Interfaces are abstract, concrete classes are final: compose, do not subclass. Progress, facts for
the manifest and warnings go through `edit3r.contract.reporting` (`track`, `note`, `warn`).
"""

from edit3r.contract.command import Command
from edit3r.contract.component import Configured
from edit3r.contract.interfaces.editing import (
    ChangesShape,
    ConditionedOnDepth,
    Editor,
    EditsRegions,
    GivesAttention,
    StartsFromImages,
)
from edit3r.contract.interfaces.judging import (
    Critic,
    EditToJudge,
    HalfWay,
    SceneToJudge,
)
from edit3r.contract.interfaces.reading import Reader
from edit3r.contract.interfaces.reconstruction import (
    Backbone,
    EditsViews,
    FindsGeometry,
    GaussianHead,
    Geometry,
    Matcher,
    MatchesLevelled,
    Reconstructor,
)
from edit3r.contract.interfaces.rendering import (
    ComparesWithBefore,
    Rasterizer,
    RefineInputs,
    Refiner,
)
from edit3r.contract.interfaces.selecting import (
    Detection,
    Detector,
    Marks,
    Proposal,
    Segmenter,
    Tracks,
    as_proposal,
)
from edit3r.contract.interfaces.selection import (
    ASK,
    BACKGROUND,
    SURE,
    Box,
    Reading,
    Selected,
    Selection,
    Selector,
)
from edit3r.contract.interfaces.training import (
    Dataset,
    Loss,
    LossInputs,
    SceneSample,
    Trainer,
    TrainingJob,
)
from edit3r.contract.interfaces.writing import (
    DRAWING,
    NamedObjects,
    OtherReadings,
    SceneToWrite,
    SecondLook,
    Writer,
)

INTERFACES: dict[str, type] = {
    "reader": Reader,
    "editor": Editor,
    "segmenter": Segmenter,
    "detector": Detector,
    "selector": Selector,
    "reconstructor": Reconstructor,
    "backbone": Backbone,
    "head": GaussianHead,
    "matcher": Matcher,
    "rasterizer": Rasterizer,
    "loss": Loss,
    "dataset": Dataset,
    "trainer": Trainer,
    "refiner": Refiner,
    "critic": Critic,
    "writer": Writer,
    "command": Command,
}
"""The interface of each kind, for checks and documentation."""

__all__ = [
    "ASK",
    "BACKGROUND",
    "DRAWING",
    "INTERFACES",
    "SURE",
    "Backbone",
    "Box",
    "ChangesShape",
    "Command",
    "ComparesWithBefore",
    "ConditionedOnDepth",
    "Configured",
    "Critic",
    "Dataset",
    "Detection",
    "Detector",
    "EditToJudge",
    "Editor",
    "EditsRegions",
    "EditsViews",
    "FindsGeometry",
    "GaussianHead",
    "Geometry",
    "GivesAttention",
    "HalfWay",
    "Loss",
    "LossInputs",
    "Marks",
    "Matcher",
    "MatchesLevelled",
    "NamedObjects",
    "OtherReadings",
    "Proposal",
    "Rasterizer",
    "Reader",
    "Reading",
    "Reconstructor",
    "RefineInputs",
    "Refiner",
    "SceneSample",
    "SceneToJudge",
    "SceneToWrite",
    "SecondLook",
    "Segmenter",
    "Selected",
    "Selection",
    "Selector",
    "StartsFromImages",
    "Tracks",
    "Trainer",
    "TrainingJob",
    "Writer",
    "as_proposal",
]
