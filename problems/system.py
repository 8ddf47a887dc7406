"""Linear systems with prescribed unknowns: solve, step in time, find modes, and what the supports take up.

With unknowns split into free (i) and prescribed (d), K_ii u_i = f_i - K_id u_d, and the reactions are r_d = (K u -
f)_d.

Unknown ``i*c + a`` is component a of function i.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from iga.assembly import matrix, vector
from iga.chunk import Chunk
from iga.conditions import dirichlet
from iga.domain import Domain
from iga.field import Field
from iga.integrands import Load, Mass
from iga.linear.eigen import eigenpairs
from iga.linear.factorization import factorize
from iga.linear.solvers import solve
from problems.data import freeze

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FACTORED = 150_000
"""Unknowns up to which time stepping factors its matrix once instead of iterating in each step."""


@dataclass(frozen=True, eq=False)
class System:
    """K u = f with prescribed values of some unknowns; ``components`` per function. K may be known by its products."""

    domain: Domain
    K: Any
    f: Array
    fixed: Index
    values: Array
    components: int

    def solve(
        self, solver: str = "auto", preconditioner: Callable[[Array], Array] | None = None, tolerance: float = 1e-13
    ) -> tuple[Array, dict[str, Any]]:
        """Return all unknowns (n*c,) and the log."""
        u, log = solve(
            self.K, self.f, (self.fixed, self.values), domain=self.domain, solver=solver, tolerance=tolerance,
            preconditioner=preconditioner,
        )
        return u, {"functions": self.domain.space.n, **asdict(log)}

    def reactions(
        self, u: Array, held: Mapping[str, Any], flux: Callable[[Chunk], Array], points: int | None = None
    ) -> dict[str, Any]:
        """Return what each held boundary takes up: heat entering through it, or the force (3,) on the body.

        A function on one held boundary gives its whole reaction to that. Where several meet, each gets the integral of
        the function times the solution's own flux, and what is left of the reaction, which vanishes as the mesh is
        refined, is divided in proportion to the function's integrals. So the sum over boundaries is in balance with
        the loads, and where the solution is exact each part is, too. Empty where the space has a constraint.

        Parameters
        ----------
        held : the prescribed datum of each boundary.
        flux : of a chunk of facets what enters per area, (e, q) or (e, q, 3).
        """
        if self.domain.space.constraint is not None or not held:
            return {}
        c = self.components
        left = np.zeros_like(self.f)
        left[self.fixed] = (self.K @ u - self.f)[self.fixed]
        left = left.reshape(-1, c)
        parts, shares = {}, {}
        for name, datum in held.items():
            area = np.maximum(vector(self.domain, Load(1.0), points, boundary=name), 0.0)
            components = datum if isinstance(datum, tuple | list) else (0.0,) * c
            prescribed = np.array([component is not None for component in components])
            entering = vector(
                self.domain, lambda chunk: Load(flux(chunk), c)(chunk), points, components=c, boundary=name
            )
            parts[name], shares[name] = entering.reshape(-1, c) * prescribed, area[:, None] * prescribed
            left -= parts[name]
        total = sum(shares.values())
        rate = np.divide(left, total, out=np.zeros_like(left), where=total > 0)
        forces = {name: (parts[name] + rate * shares[name]).sum(axis=0) for name in held}
        return {name: float(force[0]) if c == 1 else force for name, force in forces.items()}


def prescribed(
    domain: Domain, data: Mapping[str, Any], components: int, points: int | None, t: float = 0.0
) -> tuple[Index, Array]:
    """Return prescribed unknowns and values at time t from data by boundary name."""
    if not data:
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    return dirichlet(domain, {name: freeze_components(datum, t) for name, datum in data.items()}, components, points)


def freeze_components(datum: Any, t: float) -> Any:
    """Freeze a datum at time t, keeping None for components that are free, and attributes for single ones."""
    if isinstance(datum, tuple | list) and any(part is None or isinstance(part, Field) for part in datum):
        return tuple(None if part is None else freeze(part, t) for part in datum)
    return freeze(datum, t)


def initial_values(domain: Domain, datum: Any, fixed: Index, values: Array, points: int | None) -> Array:
    """L2 projection (n,) of initial data, with prescribed unknowns kept."""
    M, f = matrix(domain, Mass(), points), vector(domain, Load(datum), points)
    return solve(M, f, (fixed, values), domain=domain)[0]


def stepper(
    domain: Domain, A: csr_array, fixed: Index, solver: str = "auto"
) -> Callable[[Array, Array, Array], tuple[Array, dict[str, Any]]]:
    """Return a function (right-hand side, prescribed values, last unknowns) -> (unknowns, log).

    A is factored once, unless it is large, constrained, or ``solver`` is "cg"; then each step iterates from the last.
    """
    constrained = domain.space.constraint is not None
    if solver == "cg" or constrained or (solver == "auto" and A.shape[0] > FACTORED):

        def iterate(f: Array, values: Array, start: Array) -> tuple[Array, dict[str, Any]]:
            first = None if constrained else start
            u, log = solve(A, f, (fixed, values), domain=domain, solver=solver, start=first)
            return u, {"functions": domain.space.n, **asdict(log)}

        return iterate
    free = np.setdiff1d(np.arange(A.shape[0]), fixed)
    rows = csr_array(A[free])
    coupling, inner = csr_array(rows[:, fixed]), csr_array(rows[:, free])
    factor = factorize(inner)

    def step(f: Array, values: Array, start: Array) -> tuple[Array, dict[str, Any]]:
        u = np.empty(len(f))
        right = f[free] - coupling @ values
        u[fixed], u[free] = values, factor(right)
        residual = float(np.linalg.norm(inner @ u[free] - right) / (np.linalg.norm(right) or 1.0))
        return u, {
            "functions": domain.space.n,
            "solver": "direct",
            "preconditioner": factor.name,
            "unknowns": len(free),
            "iterations": 1,
            "residual": residual,
        }

    return step


def modes_of(
    domain: Domain, K: csr_array, M: csr_array, fixed: Index, count: int
) -> tuple[Array, Array, dict[str, Any]]:
    """Lowest eigenvalues (count,), vectors (n*c, count) of K v = lambda M v with fixed unknowns zero, and the log."""
    found = eigenpairs(K, M, count, fixed, domain=domain)
    log = {
        "functions": domain.space.n,
        "unknowns": K.shape[0] - len(fixed),
        "solver": found.solver,
        "residual": float(found.residuals.max()),
    }
    return found.values, found.vectors, log
