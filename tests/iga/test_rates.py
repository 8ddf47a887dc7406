"""Observed convergence rates on every cell: L2 p + 1, H1 p, each within 0.1, and an absolute cap.

A cell can pass every identity and still not converge; only this shows it.
"""

from __future__ import annotations

import numpy as np
import pytest

from iga.assembly import matrix, vector
from iga.bernstein import bernstein, greville
from iga.cells import HEXAHEDRON, PYRAMID, TETRAHEDRON, WEDGE, Cell
from iga.conditions import dirichlet
from iga.conforming import bezier_domain, straight_domain
from iga.domain import Domain
from iga.integrands import Diffusion, Load
from iga.linear.solvers import solve
from iga.norms import Errors, errors
from tests.meshes import bend, box_complex


def exact(x: np.ndarray) -> np.ndarray:
    return np.sin(1.3 * x[..., 0]) * np.cos(x[..., 1]) * np.exp(0.5 * x[..., 2])


def gradient(x: np.ndarray) -> np.ndarray:
    a, b, c = 1.3 * x[..., 0], x[..., 1], np.exp(0.5 * x[..., 2])
    return np.stack([1.3 * np.cos(a) * np.cos(b) * c, -np.sin(a) * np.sin(b) * c, 0.5 * np.sin(a) * np.cos(b) * c], -1)


def source(x: np.ndarray) -> np.ndarray:
    return (1.3**2 + 1.0 - 0.25) * exact(x)


def solved(domain: Domain, degree: int) -> Errors:
    K = matrix(domain, Diffusion(), degree + 2)
    f = vector(domain, Load(source), degree + 2)
    u, _ = solve(K, f, fixed=dirichlet(domain, {"boundary": exact}, points=degree + 2))
    return errors(domain, u, exact, gradient, degree + 3)


def bent_box(cell: Cell, degree: int, n: int) -> Domain:
    """Box cut into one kind of cell with its map bent by a fixed polynomial, interpolated at the domain points."""
    mesh, points = box_complex(cell, n)
    flat = straight_domain(mesh, points, 1)
    basis = bernstein(cell, degree)
    nodes = greville(basis)
    low = bernstein(cell, 1).tabulate(nodes, 0)[0]
    fit = np.linalg.inv(basis.tabulate(nodes, 0)[0])
    coefficients = [fit @ bend(low @ flat.points[block.dofs]) for block in flat.space.blocks]
    return bezier_domain(mesh, degree, coefficients)


CASES = [(TETRAHEDRON, p) for p in (1, 2, 3, 4)] + [(c, p) for c in (HEXAHEDRON, WEDGE, PYRAMID) for p in (1, 2, 3)]
LEVELS = {1: (4, 8, 16), 2: (2, 4, 8), 3: (2, 4, 6), 4: (1, 2, 4)}
CAPS = {1: 1e-3, 2: 1e-4, 3: 5e-6, 4: 1e-6}


@pytest.mark.parametrize("curved", [False, True], ids=["straight", "curved"])
@pytest.mark.parametrize(("cell", "degree"), CASES)
def test_rates(cell: Cell, degree: int, curved: bool) -> None:
    levels = LEVELS[degree]
    found = []
    for n in levels:
        if curved:
            domain = bent_box(cell, degree, n)
        else:
            domain = straight_domain(*box_complex(cell, n), degree)
        found.append(solved(domain, degree))
    step = np.log(levels[-1] / levels[-2])
    l2 = np.log(found[-2].l2 / found[-1].l2) / step
    h1 = np.log(found[-2].h1 / found[-1].h1) / step
    assert found[-1].relative_l2 < CAPS[degree]
    assert abs(l2 - degree - 1) < 0.1
    assert abs(h1 - degree) < 0.1
