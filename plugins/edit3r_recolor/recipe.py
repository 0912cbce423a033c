"""How a scene was recoloured, as JSON: enough to do it again, on the same photos at any size."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

from edit3r.errors import InputError
from edit3r.io.atomic import atomic_write
from edit3r_recolor.augmentation import Fault
from edit3r_recolor.parameters import RecolorParameters

FORMAT = "edit3r recolor 1"


@dataclass(frozen=True)
class RegionRecipe:
    """One object, its colour transform, and what its proposal said of it."""

    id: int  # persistent: the same object in every view, from 1
    parameters: RecolorParameters
    area: float  # share of the first view
    stability: float
    predicted_iou: float
    box: tuple[float, float, float, float]  # x, y, width, height on the first view [pixels]


@dataclass(frozen=True)
class ViewRecipe:
    """One photo: the objects it shows and whether it was used."""

    name: str
    objects: tuple[int, ...]  # ids
    overlap: float  # of its objects with those of the most recently processed view
    processed: bool  # False: too different, left out
    faults: dict[int, Fault] = field(default_factory=dict)  # by id; what its augmented picture gets wrong


@dataclass(frozen=True)
class SceneRecipe:
    """Regions and views of a scene."""

    seed: int
    masks: str  # where they came from, such as "segmenter classical"
    regions: tuple[RegionRecipe, ...]
    views: tuple[ViewRecipe, ...]
    rejected: dict[str, int] = field(default_factory=dict)  # proposals that failed each criterion

    @property
    def processed(self) -> list[int]:
        """Indices of the views in use."""
        return [index for index, view in enumerate(self.views) if view.processed]

    def save(self, path: Path) -> None:
        """Write as JSON; floats survive exactly."""
        with atomic_write(path) as partial:
            partial.write_text(json.dumps({"format": FORMAT, **asdict(self)}, indent=1) + "\n", encoding="utf-8")

    @staticmethod
    def load(path: Path) -> "SceneRecipe":
        """Inverse of `save`. Raises InputError for any other file."""
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            if data.pop("format") != FORMAT:
                raise ValueError(f"its format is not {FORMAT!r}")
            regions = tuple(_region(region) for region in data.pop("regions"))
            return SceneRecipe(regions=regions, views=tuple(_view(view) for view in data.pop("views")), **data)
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror}).") from None
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise InputError(f"{path}: not a recipe that `edit3r recolor` wrote ({error}).") from None


def _region(data: dict) -> RegionRecipe:
    parameters = RecolorParameters.from_json(data.pop("parameters"))
    return RegionRecipe(parameters=parameters, box=tuple(data.pop("box")), **data)


def _view(data: dict) -> ViewRecipe:
    faults = {int(number): Fault.from_json(fault) for number, fault in data.pop("faults").items()}
    return ViewRecipe(objects=tuple(data.pop("objects")), faults=faults, **data)
