"""Solids on their way to a surface: what is wanted, what all steps need, how far a solid is off.

Axis letters: f facet, q sample point, k sample of the surface, c component.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.meccano.errors import Errors, errors_of
from geometry.meccano.skin import side_coordinates
from geometry.meccano.solid import Solid
from geometry.meccano.springs import SAMPLES
from geometry.simplices.surface import Surface
from iga.progress import Progress

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Target = Callable[[Index, Array], Array]

LIMB = 3.0
"""Tolerances by which something is far off: a limb that the boundary has not reached."""


@dataclass(frozen=True)
class Aims:
    """What a solid should be.

    Attributes
    ----------
    tolerance : distance from the surface, both ways.
    max_cells : most cells of the T-mesh.
    rounds : most rounds of refinement for each of the tolerances gone through.
    slides : rounds of smoothing of poor shapes at the end.
    """

    tolerance: float
    max_cells: int
    rounds: int = 8
    slides: int = 1


@dataclass(frozen=True, eq=False)
class Task:
    """What all steps need.

    Attributes
    ----------
    surface : the surface.
    target : points (q, 3) of the surface where boundary sides (q,) and coordinates s (q, 2) should be.
    aims : what the solid should be.
    there : (k, 3) samples of the surface.
    shown : progress.
    """

    surface: Surface
    target: Target
    aims: Aims
    there: Array
    shown: Progress


@dataclass(frozen=True, eq=False)
class State:
    """A solid, where its target puts samples of its facets (f q, 3), and how far it is off."""

    solid: Solid
    aim: Array
    errors: Errors

    def excess(self, aims: Aims) -> float:
        """What facets are off beyond the tolerance, in all."""
        return float(np.maximum(self.errors.worst / aims.tolerance - 1.0, 0.0).sum())

    def far(self, aims: Aims) -> bool:
        """Whether something is so far off that it is a limb."""
        return bool(self.errors.worst.max() > LIMB * aims.tolerance)


def measured(task: Task, solid: Solid, aim: Array | None = None) -> State:
    """A solid's state; ``aim`` (f q, 3) saves asking the target again on the same mesh."""
    aim = task.target(*side_coordinates(solid.skin, SAMPLES)) if aim is None else aim
    far = LIMB * task.aims.tolerance
    return State(solid, aim, errors_of(solid.skin, solid.points, aim, task.there, task.surface, far))
