r"""Heat conduction: steady, transient and its lowest modes.

    capacity du/dt - div(k grad u) = source          in the domain
    u = temperature                                  on some boundaries,
    n . k grad u = flux                              on others (heat that enters, per area),
    n . k grad u = h (ambient - u)                   where there is convection; zero flux elsewhere.

k is a number, a (3, 3) tensor, a formula of either shape, a function or a field. Time stepping: the theta scheme

    M (u1 - u0)/dt + K (theta u1 + (1 - theta) u0) = theta f1 + (1 - theta) f0

(order 1, and 2 for theta = 1/2) and BDF2, M (3 u2 - 4 u1 + u0)/(2 dt) + K u2 = f2 (order 2, started by one step of
theta = 1/2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from iga.assembly import matrix, vector
from iga.clock import Clock
from iga.conditions import DependentTracesError
from iga.domain import Domain
from iga.errors import InputError
from iga.integrands import Diffusion, Load, Mass
from iga.nitsche import nitsche
from problems.data import Datum, Sample, depends_on_time, exclude, freeze, resolve, values
from problems.material import checked, is_tensor
from problems.rigid import parts_of
from problems.solution import Quantity, Solution, primary
from problems.system import System, initial_values, modes_of, prescribed, stepper

Array = NDArray[np.float64]

SOLVERS = ("auto", "direct", "cg")


@dataclass(frozen=True, eq=False)
class Convection:
    """Heat exchange with surroundings: ``coefficient`` h > 0 and ``ambient`` temperature."""

    coefficient: Datum
    ambient: Datum = 0.0


@dataclass(frozen=True, eq=False)
class Heat:
    """Data of heat conduction; boundaries are given by name or shell pattern.

    Attributes
    ----------
    conductivity : number, (3, 3), formula, function of x or field; positive (definite)
    source : heat per volume (and time)
    temperature, flux, convection : conditions; a boundary carries a temperature or the others, flux and convection may
    add
    capacity : density times specific heat, for transient problems and modes
    """

    conductivity: Any = 1.0
    source: Datum = 0.0
    temperature: Mapping[str, Datum] = field(default_factory=dict)
    flux: Mapping[str, Datum] = field(default_factory=dict)
    convection: Mapping[str, Convection] = field(default_factory=dict)
    capacity: Any = 1.0


def solve(problem: Heat, domain: Domain, solver: str = "auto", points: int | None = None) -> Solution:
    """Solve the steady problem; where functions are dependent on the boundary, temperatures are imposed weakly.

    Parameters
    ----------
    solver : "auto", "direct" or "cg"
    points : Gauss points per direction, by default those of `iga.chunk.default_points`

    Raises
    ------
    InputError
        Unknown solver or boundaries, conditions that exclude each other, a material that is not positive, or a
        temperature that nothing fixes.
    """
    if solver not in SOLVERS:
        raise InputError(f"heat conduction has no solver {solver!r}; there are: {', '.join(SOLVERS)}")
    clock = Clock()
    problem = resolved(problem, domain)
    check_level(problem, domain)
    conductivity = checked(problem.conductivity, "conductivity", 3, domain)
    K, exchange = stiffness(problem, domain, conductivity, points)
    f = load(problem, domain, points, 0.0)
    held = problem.temperature
    try:
        fixed, value = prescribed(domain, held, 1, points)
    except DependentTracesError:
        held, fixed, value = {}, np.zeros(0, dtype=np.int64), np.zeros(0)
        grip, pull = weakly(problem, domain, conductivity, points)
        exchange = grip if exchange is None else exchange + grip
        f += pull
    system = System(domain, K + exchange if exchange is not None else K, f, fixed, value, 1)
    clock.lap("assemble_s")
    u, log = system.solve(solver)
    clock.lap("solve_s")
    log = {**log, **clock.laps, "energy": 0.5 * float(u @ (K @ u)), "weak": held is not problem.temperature}
    quantities = quantities_of(u, conductivity)
    outward = quantities["heat_flux"].evaluate
    reactions = system.reactions(u, held, lambda chunk: -(outward(chunk) * chunk.normal).sum(axis=-1), points)
    return Solution(domain, "heat", u, quantities, log, reactions)


def weakly(problem: Heat, domain: Domain, conductivity: Any, points: int | None) -> tuple[csr_array, Array]:
    """Matrix (n, n) and vector (n,) that impose the temperatures by Nitsche's method."""
    frozen = {name: freeze(datum) for name, datum in problem.temperature.items()}
    return nitsche(domain, frozen, Diffusion(conductivity), points=points)


def resolved(problem: Heat, domain: Domain) -> Heat:
    """Return the problem with patterns replaced by the names they match, or raise if conditions exclude each other."""
    temperature = resolve(domain, problem.temperature, "temperature")
    flux = resolve(domain, problem.flux, "flux")
    convection = resolve(domain, problem.convection, "convection")
    exclude(temperature, flux, ("temperature", "flux"))
    exclude(temperature, convection, ("temperature", "convection"))
    return replace(problem, temperature=temperature, flux=flux, convection=convection)


def check_level(problem: Heat, domain: Domain) -> None:
    """Raise if no boundary of some part fixes the level of the temperature."""
    count, label = parts_of(domain.space)
    held = np.zeros(count, dtype=bool)
    for name in (*problem.temperature, *problem.convection):
        for facets in domain.boundaries[name]:
            held[label[domain.space.blocks[facets.block].dofs[facets.elements]]] = True
    if not held.all():
        part = int(np.argmin(held))
        where = (
            ""
            if count == 1
            else " of the part near ({:.4g}, {:.4g}, {:.4g})".format(*domain.points[label == part].mean(axis=0))
        )
        raise InputError(
            f"nothing fixes the temperature{where}: give a temperature or a convection on one of its boundaries"
        )


def stiffness(
    problem: Heat, domain: Domain, conductivity: Any, points: int | None
) -> tuple[csr_array, csr_array | None]:
    """Return the matrices (n, n) of conduction and of convection (None without it)."""
    K = matrix(domain, Diffusion(conductivity), points)
    exchange = None
    for name, convection in problem.convection.items():
        h = checked(convection.coefficient, f"convection coefficient on '{name}'", 1, domain)
        term = matrix(domain, Mass(h), points, boundary=name)
        exchange = term if exchange is None else exchange + term
    return K, exchange


def load(problem: Heat, domain: Domain, points: int | None, t: float) -> Array:
    """Return the vector (n,) of source, flux and convection at time t."""
    f = vector(domain, Load(freeze(problem.source, t)), points)
    for name, flux in problem.flux.items():
        f += vector(domain, Load(freeze(flux, t)), points, boundary=name)
    for name, convection in problem.convection.items():
        h, ambient = freeze(convection.coefficient), freeze(convection.ambient, t)

        def inflow(chunk: Any, h: Any = h, ambient: Any = ambient) -> Array:
            return Load(values(h, chunk, ()) * values(ambient, chunk, ()))(chunk)

        f += vector(domain, inflow, points, boundary=name, components=1)
    return f


def quantities_of(u: Array, conductivity: Any) -> dict[str, Quantity]:
    """Temperature and the heat flux -k grad u."""
    shape = (3, 3) if is_tensor(conductivity) else ()

    def heat_flux(sample: Sample) -> Array:
        k, slope = values(conductivity, sample, shape), sample.gradient(u)
        return -(k @ slope[..., None])[..., 0] if shape else -k[..., None] * slope

    return {"temperature": primary(u), "heat_flux": Quantity((3,), heat_flux)}


def march(
    problem: Heat,
    domain: Domain,
    initial: Datum,
    end: float,
    steps: int,
    scheme: str = "bdf2",
    theta: float = 0.5,
    solver: str = "auto",
    points: int | None = None,
    keep: bool = True,
) -> Solution:
    """Solve the transient problem from time 0 to ``end`` in equal steps.

    Parameters
    ----------
    initial : temperature at time 0
    scheme : "theta" (with ``theta`` between 0.5 and 1) or "bdf2"
    keep : store the temperature of every step in ``history`` (steps + 1, n)
    """
    if scheme not in ("theta", "bdf2"):
        raise InputError(f"time scheme '{scheme}' is unknown; there are: theta, bdf2")
    if not 0.5 <= theta <= 1.0:
        raise InputError(f"theta = {theta:g} is outside [0.5, 1], where the scheme is stable for any step")
    if steps < 1 or not end > 0:
        raise InputError(f"time must run forward: end = {end:g} with {steps} steps")
    clock = Clock()
    problem = resolved(problem, domain)
    conductivity = checked(problem.conductivity, "conductivity", 3, domain)
    capacity = checked(problem.capacity, "capacity", 1, domain)
    conduction, exchange = stiffness(problem, domain, conductivity, points)
    K = conduction if exchange is None else conduction + exchange
    M = matrix(domain, Mass(capacity), points)
    fixed, value = prescribed(domain, problem.temperature, 1, points, 0.0)
    moving = any(depends_on_time(datum) for datum in problem.temperature.values())
    varying = any(
        depends_on_time(datum)
        for datum in (problem.source, *problem.flux.values(), *(c.ambient for c in problem.convection.values()))
    )
    u = initial_values(domain, freeze(initial, 0.0), fixed, value, points)
    f = load(problem, domain, points, 0.0)
    clock.lap("assemble_s")
    dt = end / steps
    times: Array = dt * np.arange(steps + 1, dtype=np.float64)
    history = [u]
    first = theta if scheme == "theta" else 0.5
    single = stepper(domain, M / dt + first * K, fixed, solver)
    double = stepper(domain, 1.5 / dt * M + K, fixed, solver) if scheme == "bdf2" and steps > 1 else None
    log: dict[str, Any] = {}
    before = u
    for k in range(1, steps + 1):
        t = float(times[k])
        following = load(problem, domain, points, t) if varying else f
        if moving:
            value = prescribed(domain, problem.temperature, 1, points, t)[1]
        if k == 1 or double is None:
            right = M @ u / dt - (1 - first) * (K @ u) + first * following + (1 - first) * f
            new, log = single(right, value, u)
        else:
            right = M @ (4 * u - before) / (2 * dt) + following
            new, log = double(right, value, u)
        before, u, f = u, new, following
        if keep:
            history.append(u)
    clock.lap("solve_s")
    log = {**log, **clock.laps, "energy": 0.5 * float(u @ (conduction @ u)), "steps": steps, "scheme": scheme}
    return Solution(
        domain,
        "transient heat",
        u,
        quantities_of(u, conductivity),
        log,
        times=times,
        history=np.array(history) if keep else None,
    )


def modes(
    problem: Heat, domain: Domain, count: int = 6, points: int | None = None
) -> tuple[Array, Array, dict[str, Any]]:
    """Lowest decay rates (count,) and shapes (n, count), K phi = lambda M phi with prescribed temperatures zero."""
    clock = Clock()
    problem = resolved(problem, domain)
    conductivity = checked(problem.conductivity, "conductivity", 3, domain)
    conduction, exchange = stiffness(problem, domain, conductivity, points)
    M = matrix(domain, Mass(checked(problem.capacity, "capacity", 1, domain)), points)
    fixed = prescribed(domain, dict.fromkeys(problem.temperature, 0.0), 1, points)[0]
    clock.lap("assemble_s")
    values, shapes, log = modes_of(domain, conduction if exchange is None else conduction + exchange, M, fixed, count)
    clock.lap("solve_s")
    return values, shapes, {**log, **clock.laps}
