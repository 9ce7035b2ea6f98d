"""Built-in scenes, generated: each function returns a `Scene` and a `Camera` that frames it.

Light is set for an exposure of 0 EV. Metres; the same numbers on every call.
"""

from .cornell_box import cornell_box as cornell_box
from .material_grid import material_grid as material_grid
from .stage import stage as stage

SCENES = {"stage": stage, "cornell_box": cornell_box, "material_grid": material_grid}
