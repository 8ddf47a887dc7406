"""The cube benchmark: seconds, memory and error for heat and elasticity on a curved single-patch cube.

The unit cube with the interior map x = X + 0.3 g, y = Y - 0.3 g, z = Z + 0.2 g, g = 4 X(1-X) Y(1-Y) Z(1-Z), splines of
maximal smoothness. p Gauss points per direction reach the errors of p + 1 to two or three digits (heat, p = 3, n = 16:
8.977e-7 against 8.976e-7; elasticity, p = 2, n = 8: 2.85e-4 against 2.88e-4), because they integrate degree 2p - 1
exactly and smooth splines have no modes that such a rule misses; the error itself is measured with p + 2. The exact
solution is u = sin(pi x) sin(pi y) sin(pi z) (times 1/3, 2/3 and 1 for the components of elasticity, E = 1, nu = 0.3),
zero on the boundary. Systems are solved by conjugate gradients, preconditioned by fast diagonalisation, to relative
residual 1e-10.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.nurbs.domain import build_domain
from geometry.nurbs.shapes import bench_cube
from iga.assembly import matrix, vector
from iga.conditions import trace_functions
from iga.domain import Domain, all_facets
from iga.errors import InputError
from iga.frame import specialised
from iga.integrands import Diffusion, Elasticity, Load, isotropic
from iga.linear.fast_diagonalisation import fast_diagonalisation
from iga.linear.krylov import conjugate_gradients
from iga.norms import errors
from iga.operator import operator
from iga.parallel import limited
from iga.sparsity import sparsity, symmetric_product
from studies.describe import peak_mb

Array = NDArray[np.float64]

YOUNG, POISSON = 1.0, 0.3
LAME, SHEAR = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON)), YOUNG / (2 * (1 + POISSON))
AMPLITUDES = np.array([1.0, 2.0, 3.0]) / 3.0
MODES = ("assembled", "matrix-free")


def _sines(x: Array) -> list[Array]:
    """Sine of pi x by coordinate."""
    return [np.sin(np.pi * x[..., d]) for d in range(3)]


def temperature(x: Array) -> Array:
    """Exact temperature at points (..., 3)."""
    s = _sines(x)
    return s[0] * s[1] * s[2]


def heat_source(x: Array) -> Array:
    """Minus the Laplacian of the temperature."""
    return 3.0 * np.pi**2 * temperature(x)


def displacement(x: Array) -> Array:
    """Exact displacement (..., 3)."""
    return temperature(x)[..., None] * AMPLITUDES


def body_force(x: Array) -> Array:
    """Minus the divergence of the stress, (..., 3): -(lambda + mu) grad div u - mu laplace u, with u_i = a_i phi."""
    s, c = _sines(x), [np.cos(np.pi * x[..., d]) for d in range(3)]
    phi = s[0] * s[1] * s[2]
    hessian = {(0, 1): c[0] * c[1] * s[2], (0, 2): c[0] * s[1] * c[2], (1, 2): s[0] * c[1] * c[2]}
    force = np.empty(x.shape)
    for i in range(3):
        divergence = -AMPLITUDES[i] * phi
        for j in range(3):
            if j != i:
                divergence = divergence + AMPLITUDES[j] * hessian[min(i, j), max(i, j)]
        force[..., i] = np.pi**2 * (3.0 * SHEAR * AMPLITUDES[i] * phi - (LAME + SHEAR) * divergence)
    return force


def run(problem: str, degree: int, elements: int, threads: int, mode: str = "assembled") -> dict[str, Any]:
    """Run the benchmark once.

    Parameters
    ----------
    problem : "heat" or "elasticity".
    degree : of the splines, at least 2.
    elements : in each direction.
    threads : number of threads.
    mode : "assembled" or "matrix-free".

    Returns
    -------
    problem, p, points (Gauss points per direction), n_per_dir, ndofs (free unknowns), t_domain_s (building the domain;
    not in the total), t_assemble_s (matrix or operator, and load), t_solve_s (preconditioner and conjugate gradients),
    t_total_s, t_compile_s (first call's compilation, apart), l2_error, peak_rss_mb, threads, iterations, mode.

    Raises
    ------
    InputError : unknown problem or mode, or a degree below 2.
    """
    if problem not in ("heat", "elasticity"):
        raise InputError(f"there is no benchmark problem {problem!r}; there are: heat, elasticity")
    if mode not in MODES:
        raise InputError(f"there is no mode {mode!r}; there are: {', '.join(MODES)}")
    if degree < 2:
        raise InputError(f"degree {degree}: the map of the cube needs at least 2")
    with limited(threads):
        began = time.perf_counter()
        with specialised():
            _solve(problem, _domain(degree, 3 * degree), mode)  # large enough for every path that is taken below
        compiled = time.perf_counter()
        domain = _domain(degree, elements)
        built = time.perf_counter()
        solution, ndofs, iterations, assembled = _solve(problem, domain, mode)
        solved = time.perf_counter()
        exact = temperature if problem == "heat" else displacement
        error = errors(domain, solution, exact, points=degree + 2).l2
    return {
        "problem": problem,
        "p": degree,
        "points": degree,
        "n_per_dir": elements,
        "ndofs": ndofs,
        "t_domain_s": built - compiled,
        "t_assemble_s": assembled - built,
        "t_solve_s": solved - assembled,
        "t_total_s": solved - built,
        "t_compile_s": compiled - began,
        "l2_error": error,
        "peak_rss_mb": peak_mb(),
        "threads": threads,
        "iterations": iterations,
        "mode": mode,
    }


def _domain(degree: int, elements: int) -> Domain:
    return build_domain(bench_cube(degree, elements), "bench_cube", {"degree": degree, "elements": elements})


def _solve(problem: str, domain: Domain, mode: str) -> tuple[Array, int, int, float]:
    """Solution, number of free unknowns, iterations, and the time when the system was ready."""
    integrand: Diffusion | Elasticity = Diffusion() if problem == "heat" else Elasticity(isotropic(LAME, SHEAR))
    load = Load(heat_source) if problem == "heat" else Load(body_force, components=3)
    c = integrand.components
    points = max(domain.space.blocks[0].basis.degree)
    K: Any = matrix(domain, integrand, points) if mode == "assembled" else operator(domain, integrand, points)
    f = vector(domain, load, points)
    inside = np.ones((domain.space.n, c), dtype=bool)
    inside[trace_functions(domain, all_facets(domain))] = False
    free = np.flatnonzero(inside)
    ready = time.perf_counter()
    precondition = fast_diagonalisation(domain, integrand, free)
    assert precondition is not None
    full = np.zeros(len(f))
    product = symmetric_product(sparsity(domain.space), K, c) if mode == "assembled" else K.__matmul__

    def apply(x: Array) -> Array:
        full[free] = x
        return product(full)[free]

    found, iterations, _ = conjugate_gradients(apply, f[free], precondition, np.zeros(len(free)), tolerance=1e-10)
    solution = np.zeros(len(f))
    solution[free] = found
    return solution.reshape(-1, c) if c > 1 else solution, len(free), iterations, ready
