r"""Linear elasticity: static and its lowest modes.

    -div sigma = body force,   sigma = C (strain(u) - expansion * temperature * m),   m = (1, 1, 1, 0, 0, 0)
    u = displacement (whole, or some components)   on some boundaries,
    u . n = normal displacement, no friction       on others (also curved ones: weakly, by Nitsche's method),
    sigma n = traction - pressure n - S u          on others; stress-free elsewhere.

C (6, 6) in Voigt order xx, yy, zz, yz, xz, xy with engineering shear. The elastic support S is k (all directions) or
k n n^T (along the normal). A body whose supports leave rigid motions free is refused, and the motions are named.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from iga import integrands
from iga.assembly import matrix, vector
from iga.chunk import Chunk, chunks
from iga.clock import Clock
from iga.conditions import DependentTracesError
from iga.domain import Domain
from iga.errors import InputError
from iga.field import Field
from iga.integrands import InitialStrain, Load, Mass, Pressure
from iga.linear.componentwise import componentwise
from iga.nitsche import nitsche
from iga.operator import operator
from iga.sparsity import sparsity
from problems.data import Datum, Sample, exclude, freeze, resolve, values
from problems.material import checked, isotropic
from problems.rigid import describe_free
from problems.solution import Quantity, Solution, primary
from problems.system import System, freeze_components, modes_of, prescribed

Array = NDArray[np.float64]

SOLVERS = ("auto", "direct", "cg", "matrix-free")
LARGE = 300_000_000
"""Entries of a matrix above which it is not assembled: 3.6 GB, and about three times that to solve with it."""
LEAN_TOLERANCE = 1e-11
"""Relative residual of a solution without a matrix, which has no bound of its rounding errors."""


@dataclass(frozen=True, eq=False)
class Support:
    """Elastic support: ``stiffness`` k (force per area and displacement), along the normal or in all directions."""

    stiffness: Datum
    normal: bool = False


@dataclass(frozen=True, eq=False)
class Elasticity:
    """Data of linear elasticity; boundaries are given by name or shell pattern.

    Attributes
    ----------
    stiffness : (6, 6), formula of that shape, function of x or field; see :mod:`problems.material`
    body_force : force per volume (3,)
    displacement : (3,) per boundary; components that are None stay free
    normal_displacement : u . n per boundary, the surface slides; 0 on a plane of symmetry of any direction
    traction, pressure, support : loads and elastic supports; a component is either held or loaded
    expansion : thermal strain per degree, a number or Voigt vector (6,)
    temperature : rise above the stress-free temperature: number, formula, function, field
    density : mass per volume, for modes
    """

    stiffness: Any = field(default_factory=lambda: isotropic(1.0, 0.3))
    body_force: Datum = (0.0, 0.0, 0.0)
    displacement: Mapping[str, Any] = field(default_factory=dict)
    traction: Mapping[str, Datum] = field(default_factory=dict)
    pressure: Mapping[str, Datum] = field(default_factory=dict)
    support: Mapping[str, Support] = field(default_factory=dict)
    expansion: float | ArrayLike = 0.0
    temperature: Datum = 0.0
    density: Any = 1.0
    normal_displacement: Mapping[str, Datum] = field(default_factory=dict)


def solve(problem: Elasticity, domain: Domain, solver: str = "auto", points: int | None = None) -> Solution:
    """Solve the static problem; where functions are dependent on the boundary, displacements are imposed weakly.

    Parameters
    ----------
    solver : "auto", "direct", "cg" or "matrix-free"; auto takes the last where the matrix would have more than `LARGE`
        entries and the problem allows it
    points : Gauss points per direction, by default those of `iga.chunk.default_points`

    Raises
    ------
    InputError
        Unknown solver, or one without a matrix where one is needed. Unknown boundaries, conditions that exclude each
        other, a material that is not positive definite, supports that leave rigid motions free (they are named), or
        single components where displacements can only be imposed weakly.
    """
    if solver not in SOLVERS:
        raise InputError(f"elasticity has no solver {solver!r}; there are: {', '.join(SOLVERS)}")
    clock = Clock()
    problem = resolved(problem, domain)
    C = checked(problem.stiffness, "stiffness", 6, domain)
    held = problem.displacement
    springs = support_matrix(problem, domain, points)
    f = load(problem, domain, points)
    try:
        fixed, value = prescribed(domain, held, 3, points)
    except DependentTracesError:
        held, fixed, value = {}, np.zeros(0, dtype=np.int64), np.zeros(0)
        grip, pull = weakly(problem.displacement, domain, C, points)
        springs, f = grip if springs is None else springs + grip, f + pull
    if problem.normal_displacement:
        sliding, right = weakly(problem.normal_displacement, domain, C, points, normal=True)
        springs, f = sliding if springs is None else springs + sliding, f + right
    require_supports(domain, fixed, springs)
    lean = _lean(domain, C, fixed, springs, solver)
    K: Any = (operator if lean else matrix)(domain, integrands.Elasticity(C), points, components=3)
    thermal = thermal_strain(problem)
    if thermal is not None:
        heating = vector(
            domain, lambda chunk: InitialStrain(*thermal_terms(C, thermal, chunk))(chunk), points, components=3
        )
        f = f + heating
    if springs is not None:
        K = K + springs  # one matrix of all is held in memory, not two
    system = System(domain, K, f, fixed, value, 3)
    clock.lap("assemble_s")
    if lean:
        free = np.ones(domain.space.n * 3, dtype=bool)
        free[fixed] = False
        u, log = system.solve("cg", componentwise(domain, ~free.reshape(-1, 3), points), LEAN_TOLERANCE)
    else:
        u, log = system.solve(solver)
    clock.lap("solve_s")
    energy = 0.5 * float(u @ (K @ u if springs is None else K @ u - springs @ u))
    if thermal is not None:
        energy += -float(u @ heating) + thermal_energy(domain, C, thermal, points)
    log = {**log, **clock.laps, "energy": energy, "weak": held is not problem.displacement}
    quantities = quantities_of(u.reshape(-1, 3), C, thermal)
    stress = quantities["stress"].evaluate
    reactions = system.reactions(u, held, lambda chunk: traction_of(stress(chunk), chunk.normal), points)
    return Solution(domain, "elasticity", u.reshape(-1, 3), quantities, log, reactions)


def _lean(
    domain: Domain, C: Any, fixed: NDArray[np.int64], springs: csr_array | None, solver: str
) -> bool:
    """Whether to solve without a matrix."""
    if solver not in ("auto", "matrix-free"):
        return False
    held = np.bincount(fixed % 3, minlength=3).all()
    possible = not isinstance(C, Field) and domain.space.constraint is None and springs is None and bool(held)
    if solver == "matrix-free":
        if not possible:
            raise InputError(
                "a solver without a matrix needs a material without fields, each component of the displacement held "
                "somewhere, and no elastic supports, weak conditions or constraints; take solver auto"
            )
        return True
    return possible and 9 * int(sparsity(domain.space).indptr[-1]) > LARGE


def resolved(problem: Elasticity, domain: Domain) -> Elasticity:
    """Return the problem with patterns replaced by the names they match, or raise if conditions exclude each other."""
    displacement = resolve(domain, problem.displacement, "displacement")
    others = ("normal_displacement", "traction", "pressure", "support")
    loads: dict[str, Any] = {what: resolve(domain, getattr(problem, what), what.replace("_", " ")) for what in others}
    whole = {
        name: datum
        for name, datum in displacement.items()
        if not (isinstance(datum, tuple | list) and any(part is None for part in datum))
    }
    for name, datum in whole.items():
        if isinstance(datum, int | float):
            raise InputError(f"displacement on '{name}' needs three components, not one number")
    for what, names in loads.items():
        exclude(whole, names, ("displacement", what.replace("_", " ")))
    return replace(problem, displacement=displacement, **loads)


def require_supports(domain: Domain, fixed: NDArray[np.int64], springs: csr_array | None) -> None:
    """Raise unless every rigid motion is held; the message names those that are free."""
    if domain.space.constraint is not None:
        return  # unknowns are those of the constrained space; the solver checks them
    free = describe_free(domain, fixed, springs)
    if free:
        raise InputError(f"the body can move freely: {free}; hold it by displacements or elastic supports")


def support_matrix(problem: Elasticity, domain: Domain, points: int | None) -> csr_array | None:
    """Matrix (3n, 3n) of the elastic supports."""
    total = None
    for name, support in problem.support.items():
        k = checked(support.stiffness, f"support stiffness on '{name}'", 1, domain)

        def spring(chunk: Chunk, k: Any = k, normal: bool = support.normal) -> Array:
            stiffness = values(k, chunk, ())
            if not normal:
                return Mass(stiffness, 3)(chunk)
            n = chunk.normal
            return Mass(stiffness[..., None, None] * n[..., :, None] * n[..., None, :], 3)(chunk)

        term = matrix(domain, spring, points, boundary=name, components=3)
        total = term if total is None else total + term
    return total


def weakly(
    data: Mapping[str, Any], domain: Domain, C: Any, points: int | None, normal: bool = False
) -> tuple[csr_array, Array]:
    """Matrix (3n, 3n) and vector (3n,) that impose displacements, or their normal parts, by Nitsche's method."""
    frozen = {name: freeze_components(datum, 0.0) for name, datum in data.items()}
    return nitsche(domain, frozen, integrands.Elasticity(C), normal=normal, points=points)


def load(problem: Elasticity, domain: Domain, points: int | None) -> Array:
    """Vector (3n,) of body force, tractions and pressures."""
    f = vector(domain, Load(freeze(problem.body_force), 3), points)
    for name, traction in problem.traction.items():
        f += vector(domain, Load(freeze(traction), 3), points, boundary=name)
    for name, pressure in problem.pressure.items():
        f += vector(domain, Pressure(freeze(pressure)), points, boundary=name)
    return f


def thermal_strain(problem: Elasticity) -> Any:
    """Return a function sample -> strain (..., 6) of the thermal expansion, or None without any."""
    expansion = np.asarray(problem.expansion, dtype=float)
    if expansion.shape not in ((), (6,)):
        raise InputError(f"expansion is one number or six (Voigt order), not shape {expansion.shape}")
    if not expansion.any():
        return None
    unit = expansion * np.array([1.0, 1, 1, 0, 0, 0]) if expansion.shape == () else expansion
    rise = freeze(problem.temperature)
    return lambda sample: values(rise, sample, ())[..., None] * unit


def thermal_terms(C: Any, thermal: Any, chunk: Chunk) -> tuple[Array, Array]:
    """Stiffness (e, q, 6, 6) and thermal strain (e, q, 6) on a chunk."""
    return values(C, chunk, (6, 6)), thermal(chunk)


def thermal_energy(domain: Domain, C: Any, thermal: Any, points: int | None) -> float:
    """Half the integral of strain . C strain for the thermal strain."""
    total = 0.0
    for chunk in chunks(domain, points):
        D, strain = thermal_terms(C, thermal, chunk)
        total += 0.5 * float(np.einsum("eqv,eqvw,eqw,eq->", strain, D, strain, chunk.dx, optimize=True))
    return total


def quantities_of(u: Array, C: Any, thermal: Any) -> dict[str, Quantity]:
    """Displacement (3,), strain (6,), stress (6,) and von Mises stress of coefficients u (n, 3)."""

    def strain(sample: Sample) -> Array:
        return integrands.strain(sample.gradient(u))

    def stress(sample: Sample) -> Array:
        elastic = strain(sample) if thermal is None else strain(sample) - thermal(sample)
        return (values(C, sample, (6, 6)) @ elastic[..., None])[..., 0]

    return {
        "displacement": primary(u),
        "strain": Quantity((6,), strain),
        "stress": Quantity((6,), stress),
        "von_mises": Quantity((), lambda sample: von_mises(stress(sample))),
    }


def traction_of(stress: Array, normal: Array) -> Array:
    """Return the force per area (..., 3) of Voigt stresses (..., 6) on a surface with this normal (..., 3)."""
    return (stress[..., [[0, 5, 4], [5, 1, 3], [4, 3, 2]]] @ normal[..., None])[..., 0]


def von_mises(stress: Array) -> Array:
    """Return the equivalent stress (...) of Voigt stresses (..., 6)."""
    xx, yy, zz, yz, xz, xy = np.moveaxis(stress, -1, 0)
    return np.sqrt(0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) + 3.0 * (yz**2 + xz**2 + xy**2))


def modes(
    problem: Elasticity, domain: Domain, count: int = 6, points: int | None = None
) -> tuple[Array, Array, dict[str, Any]]:
    """Squares of the lowest angular frequencies (count,), shapes (n, 3, count), and the log.

    Prescribed displacements are zero. A body without supports is allowed: its first six values are zero.
    """
    clock = Clock()
    problem = resolved(problem, domain)
    C = checked(problem.stiffness, "stiffness", 6, domain)
    K = matrix(domain, integrands.Elasticity(C), points, components=3)
    springs = support_matrix(problem, domain, points)
    if problem.normal_displacement:
        sliding = weakly(problem.normal_displacement, domain, C, points, normal=True)[0]
        springs = sliding if springs is None else springs + sliding
    density = checked(problem.density, "density", 1, domain)
    M = matrix(domain, Mass(density, 3), points)
    zero = {
        name: tuple(None if part is None else 0.0 for part in datum) if isinstance(datum, tuple | list) else (0.0,) * 3
        for name, datum in problem.displacement.items()
    }
    fixed = prescribed(domain, zero, 3, points)[0]
    clock.lap("assemble_s")
    value, vectors, log = modes_of(domain, K if springs is None else K + springs, M, fixed, count)
    clock.lap("solve_s")
    return value, vectors.reshape(-1, 3, len(value)), {**log, **clock.laps}
