"""The Catmull-Clark benchmark runs through all its stages and interpolates to the stated residual."""

from __future__ import annotations

import meshio
import numpy as np
import pytest

from geometry.catmull_clark.shapes import box
from iga.cells import HEXAHEDRON
from iga.errors import InputError
from studies.bench_catmull_clark import STAGES, TOLERANCE, run


def test_stages_of_the_prism() -> None:
    found = run(400, 1)
    assert found["hexes"] == 360
    assert set(found["s_per_million"]) == set(STAGES[:4])
    assert sum(found[f"t_{stage}_s"] for stage in STAGES[:4]) == pytest.approx(found["t_total_s"])
    assert 0 < found["residual"] <= TOLERANCE
    assert found["steps"]["interior"] > 10


def test_stiffness_of_a_file(tmp_path) -> None:
    points, cells = box(3, 3, 3)
    path = tmp_path / "box.vtk"
    meshio.write(path, meshio.Mesh(points, [("hexahedron", cells[:, np.array(HEXAHEDRON.vtk)])]))
    found = run(mesh=path, stiffness=True)
    assert (found["mesh"], found["hexes"], found["functions"]) == ("box.vtk", 27, 64)
    assert set(found["s_per_million"]) == set(STAGES)


def test_too_few_cells() -> None:
    with pytest.raises(InputError, match="at least 40 cells"):
        run(10)
