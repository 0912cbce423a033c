"""What other plugins may import from this one: region-wise recolouring (section 3.2) and its sets.

- `recolored` changes every region of some views by one `RecolorParameters` each;
  `visible_parameters` draws them.
- `draw_outline`, `with_outline` and `perturbed` give an edit the faults of a 2D editor (section
  4.4).
- `SceneRecipe`, `RECIPE` and `MASKS` are the description and the places of what `edit3r recolor`
  wrote.
"""

from edit3r_recolor.folder import MASKS, RECIPE, write_masks
from edit3r_recolor.recoloring import (
    RecolorParameters,
    draw_outline,
    perturbed,
    recolored,
    visible_parameters,
    with_outline,
)
from edit3r_recolor.scene import RegionRecipe, SceneRecipe, ViewRecipe

__all__ = [
    "MASKS",
    "RECIPE",
    "RecolorParameters",
    "RegionRecipe",
    "SceneRecipe",
    "ViewRecipe",
    "draw_outline",
    "perturbed",
    "recolored",
    "visible_parameters",
    "with_outline",
    "write_masks",
]
