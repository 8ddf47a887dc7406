"""Manufactured solutions: one expression for u gives every other datum by exact differentiation.

    heat        source = capacity du/dt - div(k grad u),   flux = k grad u   (heat entering through n: n . k grad u)
    elasticity  body force = -div sigma,   sigma = C (strain(u) - thermal strain),   traction = sigma n

k is a number, a (3, 3) tensor or a formula of either shape; C (6, 6) in Voigt order or a formula of that shape.
:func:`solve_exact` poses the problem whose solution a formula is, solves it and measures the error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray

from iga.domain import Domain
from iga.errors import InputError
from iga.integrands import VOIGT
from problems import elasticity as elasticity_problem
from problems import heat as heat_problem
from problems.formula import SPACE, SYMBOLS, Formula, from_array, parse_vector
from problems.material import Array, isotropic, symbolic
from problems.solution import Solution


@dataclass(frozen=True)
class Exact:
    """An exact solution and what follows from it; all are functions of x (..., 3) and t.

    Attributes
    ----------
    u : temperature () or displacement (3,)
    gradient : (3,) or (3, 3) with [i, j] = du_i/dx_j
    source : heat source () or body force (3,)
    flux : k grad u (3,), or the stress (3, 3)
    """

    u: Formula
    gradient: Formula
    source: Formula
    flux: Formula

    def through(self, normal: Sequence[float] | Array) -> Formula:
        """Return the inward heat flux or the traction on a plane with this constant unit normal (3,)."""
        entries = sum(self.flux.array()[..., j] * sympy.Float(normal[j]) for j in range(3))
        return from_array(np.asarray(entries), f"{self.flux.text} on a plane")


def heat(u: Formula | str, conductivity: Any = 1.0, capacity: Any = 1.0) -> Exact:
    """Return source and flux of heat conduction with the temperature u (a formula in x, y, z and t)."""
    u = parse_vector(u, 1) if isinstance(u, str) else u
    if u.shape != ():
        raise InputError(f"a temperature is one formula, '{u.text}' has {len(u.expressions)}")
    k = symbolic(conductivity)
    gradient = u.gradient()
    slope = gradient.array()
    flux = k * slope if np.ndim(k) == 0 else k @ slope
    source = symbolic(capacity) * u.expressions[0].diff(SYMBOLS["t"]) - sum(flux[j].diff(SPACE[j]) for j in range(3))
    return Exact(u, gradient, from_array(source, f"source of {u.text}"), from_array(flux, f"flux of {u.text}"))


def elasticity(u: Formula | str, stiffness: Any, thermal_strain: Formula | None = None) -> Exact:
    """Return body force and stress with the displacement u (three formulas) and the strain (6,) of expansion."""
    u = parse_vector(u, 3) if isinstance(u, str) else u
    if u.shape != (3,):
        raise InputError(f"a displacement is three formulas separated by ';', '{u.text}' has {len(u.expressions)}")
    C = symbolic(stiffness)
    gradient = u.gradient()
    g = gradient.array()
    strain = np.array([g[i, j] if i == j else g[i, j] + g[j, i] for i, j in VOIGT], dtype=object)
    if thermal_strain is not None:
        strain = strain - thermal_strain.array()
    stress = full(C @ strain)
    force = np.array([-sum(stress[i, j].diff(SPACE[j]) for j in range(3)) for i in range(3)], dtype=object)
    return Exact(u, gradient, from_array(force, f"body force of {u.text}"), from_array(stress, f"stress of {u.text}"))


def isotropic_strain(expansion: float, temperature: Formula) -> Formula:
    """Return the thermal strain (6,) of a temperature rise, as a formula."""
    swelling = symbolic(expansion) * temperature.expressions[0]
    zero = sympy.Integer(0)
    return Formula(f"thermal strain of {temperature.text}", (swelling,) * 3 + (zero,) * 3, (6,))


def solve_exact(
    domain: Domain,
    physics: str,
    expression: str,
    solver: str = "auto",
    points: int | None = None,
    material: Any = None,
) -> tuple[Solution, dict[str, Any]]:
    """Solve the problem whose exact solution is a formula: source and values on every boundary follow from it.

    Parameters
    ----------
    physics : "heat" or "elasticity"
    expression : a formula in x, y, z, or three separated by ``;`` for elasticity
    solver : "auto", "direct" or "cg", for elasticity also "matrix-free"
    points : Gauss points per direction, by default those of `iga.chunk.default_points`
    material : conductivity (1 by default) or stiffness (6, 6) (E = 1, nu = 0.3 by default)

    Returns
    -------
    The solution with its ``norms``, and its summary. H1 means the seminorm: the L2 norm of the gradient, and
    ``relative_h1`` divides by that of the exact gradient.
    """
    if physics == "heat":
        known = heat(parse_vector(expression, 1, ("x", "y", "z")), 1.0 if material is None else material)
        conduction = heat_problem.Heat(1.0 if material is None else material, known.source, {"*": known.u})
        solution = heat_problem.solve(conduction, domain, solver, points)
    elif physics == "elasticity":
        stiffness = isotropic(1.0, 0.3) if material is None else material
        known = elasticity(parse_vector(expression, 3, ("x", "y", "z")), stiffness)
        body = elasticity_problem.Elasticity(stiffness, known.source, {"*": known.u})
        solution = elasticity_problem.solve(body, domain, solver, points)
    else:
        raise InputError(f"problem '{physics}' is unknown; there are: heat, elasticity")
    solution = solution.compared(known.u, points)
    return solution, solution.summary()


def full(voigt: NDArray[np.object_]) -> NDArray[np.object_]:
    """Return the symmetric tensor (3, 3) of a stress in Voigt order (6,)."""
    result = np.empty((3, 3), dtype=object)
    for k, (i, j) in enumerate(VOIGT):
        result[i, j] = result[j, i] = voigt[k]
    return result
