"""Where the real models are that studies take at full size: the folder ``shared/data`` beside this checkout.

It holds ``surface``, ``hex``, ``tet``, ``cad`` and ``nurbs``. Without it, studies run on shapes made by code alone.
"""

from __future__ import annotations

from pathlib import Path

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
CAD = DATA / "cad"
HEXES = DATA / "hex"
SURFACES = DATA / "surface"
TETS = DATA / "tet"
