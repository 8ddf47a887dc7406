r"""A solid inside a sheet: what its boundary should be is known, its inside is not.

The inside is harmonic in the straight picture of the meccano at first, folded in places. All control points are then
moved at once until no element is folded, those of the boundary held by springs at the sheet (`moving.unfolded`).

Axis letters: n function, m boundary function, c component.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geometry.meccano import moving
from geometry.meccano.fitting import harmonic
from geometry.meccano.skin import Skin
from geometry.meccano.solid import Solid, held, sizes_of
from iga.progress import QUIET, Progress

Array = NDArray[np.float64]

_HOLD = 0.2
"""A spring has an energy of one, as much as an ideal element, at this share of the smallest element around."""


def unfolded(skin: Skin, sheet: Array, shown: Progress = QUIET) -> Solid:
    """A solid near a sheet; whether it is valid, its ``invalid`` says.

    Parameters
    ----------
    sheet : control points (n, 3), of which those of boundary functions count.
    """
    inside = harmonic(skin.space, sheet, skin.functions)
    solid = Solid(skin.space, skin, inside, np.empty(0, dtype=np.int64))
    weights = (_HOLD * sizes_of(solid)[skin.functions]) ** -2.0
    return moving.unfolded(solid, held(skin, sheet[skin.functions], weights), shown)
