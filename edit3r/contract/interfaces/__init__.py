"""The interface of every kind of component.

Each concrete class has a nested `Settings` (a subclass of `edit3r.Settings`, every field with
default, range and description) and is constructed by the registry as `Class(settings, **parts)`.
Interfaces are abstract, concrete classes are final: compose, do not subclass. Progress, facts for
the manifest and warnings go through `edit3r.contract.reporting` (`track`, `note`, `warn`).
"""

from edit3r.contract.command import Command as Command
from edit3r.contract.component import Configured as Configured
from edit3r.contract.instructions import Box as Box
from edit3r.contract.interfaces.editing import (
    ChangesShape as ChangesShape,
    ConditionedOnDepth as ConditionedOnDepth,
    Editor as Editor,
    EditsRegions as EditsRegions,
    GivesAttention as GivesAttention,
    HidesThings as HidesThings,
    StartsFromImages as StartsFromImages,
)
from edit3r.contract.interfaces.judging import (
    Critic as Critic,
    EditToJudge as EditToJudge,
    HalfWay as HalfWay,
    Reference as Reference,
    SceneToJudge as SceneToJudge,
)
from edit3r.contract.interfaces.reading import Reader as Reader
from edit3r.contract.interfaces.reconstruction import (
    Backbone as Backbone,
    EditsViews as EditsViews,
    FindsGeometry as FindsGeometry,
    GaussianHead as GaussianHead,
    Geometry as Geometry,
    Matcher as Matcher,
    MatchesCorrected as MatchesCorrected,
    Reconstructor as Reconstructor,
    StartsFromScene as StartsFromScene,
)
from edit3r.contract.interfaces.refining import (
    ComparesWithBefore as ComparesWithBefore,
    RefineInputs as RefineInputs,
    Refiner as Refiner,
)
from edit3r.contract.interfaces.rendering import Rasterizer as Rasterizer
from edit3r.contract.interfaces.segmentation import (
    SUBJECT as SUBJECT,
    Click as Click,
    Detection as Detection,
    Detector as Detector,
    MaskLogits as MaskLogits,
    PixelBox as PixelBox,
    Proposal as Proposal,
    Segmenter as Segmenter,
    Tracks as Tracks,
)
from edit3r.contract.interfaces.selection import (
    ASK as ASK,
    BACKGROUND as BACKGROUND,
    SURE as SURE,
    Candidate as Candidate,
    Selected as Selected,
    Selection as Selection,
    Selector as Selector,
    candidate_flags as candidate_flags,
)
from edit3r.contract.interfaces.training import (
    Dataset as Dataset,
    Loss as Loss,
    LossInputs as LossInputs,
    SceneSample as SceneSample,
    Trainer as Trainer,
    TrainingJob as TrainingJob,
)
from edit3r.contract.interfaces.writing import (
    DRAWING as DRAWING,
    NamedObjects as NamedObjects,
    OtherCandidates as OtherCandidates,
    SceneToWrite as SceneToWrite,
    SecondLook as SecondLook,
    Writer as Writer,
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
