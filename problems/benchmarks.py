r"""Problems with known answers.

Each function takes the names of the boundaries and the data, and returns a :class:`Benchmark`: the problem and its
exact solution, whose gradient, flux and stress follow by exact differentiation. The domain is the caller's; what it
must look like is said in each docstring. Symmetry planes are rollers.

Sources: thick sphere and cylinder (Lame), plate with a hole (Kirsch; displacements for plane strain), cantilever with
an end load and heated sphere: Timoshenko and Goodier, Theory of Elasticity, 3rd edition 1970; the displacements of the
cantilever as in Augarde and Deeks (2008), doi:10.1016/j.finel.2008.01.010. Edge singularity r^(2/3): Grisvard, Elliptic
Problems in Nonsmooth Domains, 1985.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi

from iga.domain import Domain
from problems import elasticity, heat, manufactured
from problems.formula import Formula, parse
from problems.manufactured import Exact
from problems.material import isotropic
from problems.solution import Solution

RADIUS = "((x**2 + y**2 + z**2)**0.5)"
PLANAR = "(x**2 + y**2)"


@dataclass(frozen=True, eq=False)
class Benchmark:
    """A problem and its exact solution.

    Attributes
    ----------
    problem : data of heat conduction or elasticity
    exact : its solution with gradient and flux or stress
    h1_rate : expected H1 rate where the solution is singular, None where it is smooth (then the degree)
    """

    problem: heat.Heat | elasticity.Elasticity
    exact: Exact
    h1_rate: float | None = None

    def solve(self, domain: Domain, solver: str = "auto", points: int | None = None) -> Solution:
        """Solve on a domain and measure the distance to the exact solution."""
        if isinstance(self.problem, heat.Heat):
            solution = heat.solve(self.problem, domain, solver, points)
        else:
            solution = elasticity.solve(self.problem, domain, solver, points)
        return solution.compared(self.exact.u, points)


def rollers(x: str | None, y: str | None, z: str | None) -> dict[str, tuple[float | None, ...]]:
    """Displacement conditions of symmetry planes normal to x, y and z, by their boundary names."""
    return {
        name: tuple(0.0 if axis == k else None for k in range(3))
        for axis, name in enumerate((x, y, z))
        if name is not None
    }


# --- heat ------------------------------------------------------------------------------------------------------------


def hollow_sphere_heat(
    inner: str = "inner",
    outer: str = "outer",
    radii: tuple[float, float] = (1.0, 2.0),
    temperatures: tuple[float, float] = (1.0, 0.0),
    conductivity: float = 1.0,
    exchange: float | None = None,
) -> Benchmark:
    """Hollow sphere (or a part cut by planes through the centre) between two temperatures: u = A + B/r.

    With ``exchange`` h the second temperature is that of the surroundings, and the outer surface convects.
    """
    (a, b), (ta, tb) = radii, temperatures
    # k u'(b) = h (tb - u(b)), or u(b) = tb for h -> infinity
    drop = 1 / a - 1 / b + (conductivity / (exchange * b**2) if exchange else 0.0)
    B = (ta - tb) / drop
    exact = manufactured.heat(f"{ta - B / a!r} + {B!r}/{RADIUS}", conductivity)
    problem = heat.Heat(conductivity, temperature={inner: ta})
    if exchange:
        return Benchmark(replace(problem, convection={outer: heat.Convection(exchange, tb)}), exact)
    return Benchmark(replace(problem, temperature={inner: ta, outer: tb}), exact)


def fichera_corner(boundary: str = "*") -> Benchmark:
    """Fichera corner, the cube (-1, 1)^3 less the octant x, y, z > 0, with the singularities of its three re-entrant
    edges.

    u = sum over the edges, z_+^3 r^(2/3) cos(2 psi/3), with r the distance from the edge (here the z axis) and psi the
    angle from the middle of the solid. r^(2/3) cos(2 psi/3) is harmonic and vanishes on the two faces at the edge; the
    factor z_+^3 ends it smoothly where the edge ends. u is in H^(5/3 - eps), so the H1 rate is 2/3 for every degree.
    """
    edge = "max(z,0)**3*(x**2+y**2)**(1/3)*cos(2/3*atan2(x-y,-x-y))"
    turned = [edge, *(turn(edge, names) for names in ("yzx", "zxy"))]
    exact = manufactured.heat(" + ".join(turned))
    # harmonic in the plane across the edge: the source is -u_zz alone, without the cancelling singular terms
    source = parse(
        " + ".join(turn("-6*max(z,0)" + edge[len("max(z,0)**3") :], names) for names in ("xyz", "yzx", "zxy"))
    )
    return Benchmark(heat.Heat(source=source, temperature={boundary: exact.u}), exact, h1_rate=2 / 3)


def turn(text: str, names: str) -> str:
    """Replace x, y, z in a formula by the given three letters (function names are safe: max keeps its letter)."""
    marked = text.replace("max", "MAX")
    for old, new in zip("xyz", names.upper()):
        marked = marked.replace(old, {"X": "1X", "Y": "1Y", "Z": "1Z"}[new])
    for letter in "XYZ":
        marked = marked.replace(f"1{letter}", letter.lower())
    return marked.replace("MAX", "max")


# --- elasticity ------------------------------------------------------------------------------------------------------


def thick_sphere(
    inner: str = "inner",
    outer: str = "outer",
    planes: tuple[str | None, str | None, str | None] = ("x0", "y0", "z0"),
    radii: tuple[float, float] = (1.0, 2.0),
    pressures: tuple[float, float] = (1.0, 0.0),
    E: float = 1.0,
    nu: float = 0.3,
) -> Benchmark:
    """Octant of a hollow sphere about the origin under inner and outer pressure: u_r = A r + B/r^2."""
    (a, b), (p, q) = radii, pressures
    A = (1 - 2 * nu) / E * (p * a**3 - q * b**3) / (b**3 - a**3)
    B = (1 + nu) / (2 * E) * (p - q) * a**3 * b**3 / (b**3 - a**3)
    factor = f"({A!r} + {B!r}/{RADIUS}**3)"
    C = isotropic(E, nu)
    exact = manufactured.elasticity(";".join(f"{factor}*{axis}" for axis in "xyz"), C)
    problem = elasticity.Elasticity(C, displacement=rollers(*planes), pressure={inner: p, outer: q})
    return Benchmark(problem, exact)


def thick_cylinder(
    inner: str = "inner",
    outer: str = "outer",
    planes: tuple[str | None, str | None] = ("x0", "y0"),
    ends: tuple[str, ...] = ("z0", "z1"),
    radii: tuple[float, float] = (1.0, 2.0),
    pressures: tuple[float, float] = (1.0, 0.0),
    E: float = 1.0,
    nu: float = 0.3,
) -> Benchmark:
    """Quarter of a thick cylinder about the z axis under pressure, in plane strain: u_r = A r + B/r."""
    (a, b), (p, q) = radii, pressures
    A = (1 + nu) * (1 - 2 * nu) / E * (p * a**2 - q * b**2) / (b**2 - a**2)
    B = (1 + nu) / E * (p - q) * a**2 * b**2 / (b**2 - a**2)
    factor = f"({A!r} + {B!r}/{PLANAR})"
    C = isotropic(E, nu)
    exact = manufactured.elasticity(f"{factor}*x; {factor}*y; 0", C)
    held = rollers(*planes, None)
    for end in ends:
        held |= rollers(None, None, end)
    return Benchmark(elasticity.Elasticity(C, displacement=held, pressure={inner: p, outer: q}), exact)


def plate_with_hole(
    planes: tuple[str | None, str | None] = ("x0", "y0"),
    outer: tuple[str, str] = ("x1", "y1"),
    ends: tuple[str, ...] = ("z0", "z1"),
    radius: float = 1.0,
    tension: float = 1.0,
    E: float = 1.0,
    nu: float = 0.3,
) -> Benchmark:
    """Quarter of a plate with a hole about the z axis, pulled in x, in plane strain; Kirsch's stresses act on the outer
    faces.

    ``outer`` are the plane faces with normals x and y.
    """
    mu, kappa = E / (2 * (1 + nu)), 3 - 4 * nu
    scale = tension * radius / (8 * mu)
    r = f"{PLANAR}**0.5"
    c, s = f"(x/{r})", f"(y/{r})"
    c3, s3 = f"(4*{c}**3 - 3*{c})", f"(3*{s} - 4*{s}**3)"
    near, far = f"({radius!r}/{r})", f"({r}/{radius!r})"
    ux = f"{scale!r}*({kappa + 1!r}*{far}*{c} + 2*{near}*({1 + kappa!r}*{c} + {c3}) - 2*{near}**3*{c3})"
    uy = f"{scale!r}*({kappa - 3!r}*{far}*{s} + 2*{near}*({1 - kappa!r}*{s} + {s3}) - 2*{near}**3*{s3})"
    C = isotropic(E, nu)
    exact = manufactured.elasticity(f"{ux}; {uy}; 0", C)
    held = rollers(*planes, None)
    for end in ends:
        held |= rollers(None, None, end)
    traction: dict[str, Formula] = {outer[0]: exact.through((1.0, 0.0, 0.0)), outer[1]: exact.through((0.0, 1.0, 0.0))}
    return Benchmark(elasticity.Elasticity(C, displacement=held, traction=traction), exact)


def cantilever(
    root: str = "x0",
    tip: str = "x1",
    sides: tuple[str, ...] = ("z0", "z1"),
    length: float = 4.0,
    height: float = 1.0,
    middle: float = 0.5,
    load: float = 1.0,
    E: float = 100.0,
    nu: float = 0.3,
) -> Benchmark:
    """Cantilever along x from 0 to ``length`` with a parabolic shear ``load`` (per width, downward in y) at its tip,
    plane strain.

    ``middle`` is the height y of the neutral plane. The root carries the exact displacements, which warp it slightly;
    the tip deflects by load length^3/(3 E' I) plus the share of shear.
    """
    modulus, ratio = E / (1 - nu**2), nu / (1 - nu)
    c, inertia = height / 2, height**3 / 12
    y, f = f"(y - {middle!r})", load / (6 * modulus * inertia)
    ux = f"{f!r}*{y}*((6*{length!r} - 3*x)*x + {2 + ratio!r}*({y}**2 - {c**2!r}))"
    uy = f"-{f!r}*({3 * ratio!r}*{y}**2*({length!r} - x) + {(4 + 5 * ratio) * c**2!r}*x + (3*{length!r} - x)*x**2)"
    C = isotropic(E, nu)
    exact = manufactured.elasticity(f"{ux}; {uy}; 0", C)
    held: dict[str, object] = {root: exact.u}
    for side in sides:
        held |= rollers(None, None, side)
    problem = elasticity.Elasticity(C, displacement=held, traction={tip: exact.through((1.0, 0.0, 0.0))})
    return Benchmark(problem, exact)


def heated_sphere(
    planes: tuple[str | None, str | None, str | None] = ("x0", "y0", "z0"),
    radii: tuple[float, float] = (1.0, 2.0),
    rise: float = 1.0,
    expansion: float = 1e-2,
    E: float = 1.0,
    nu: float = 0.3,
) -> Benchmark:
    """Octant of a free hollow sphere with the steady temperature ``rise`` inside and 0 outside: thermal stress.

    T = T0 + T1/r,   u_r = m (I(r)/r^2) + C1 r + C2/r^2,   I = int_a^r T s^2 ds,   m = expansion (1 + nu)/(1 - nu).
    """
    a, b = radii
    t1 = rise * a * b / (b - a)
    t0 = -t1 / b
    m = expansion * (1 + nu) / (1 - nu)

    def heat_in(r: float) -> float:
        return t0 * (r**3 - a**3) / 3 + t1 * (r**2 - a**2) / 2

    # radial stress zero at a and b
    c1 = 2 * (1 - 2 * nu) * expansion / (1 - nu) * heat_in(b) / (b**3 - a**3)
    c2 = c1 * (1 + nu) * a**3 / (2 * (1 - 2 * nu))
    constant = c2 - m * (t0 * a**3 / 3 + t1 * a**2 / 2)
    factor = f"({c1 + m * t0 / 3!r} + {m * t1 / 2!r}/{RADIUS} + {constant!r}/{RADIUS}**3)"
    temperature = parse(f"{t0!r} + {t1!r}/{RADIUS}")
    C = isotropic(E, nu)
    thermal = manufactured.isotropic_strain(expansion, temperature)
    exact = manufactured.elasticity(";".join(f"{factor}*{axis}" for axis in "xyz"), C, thermal)
    problem = elasticity.Elasticity(C, displacement=rollers(*planes), expansion=expansion, temperature=temperature)
    return Benchmark(problem, exact)


# --- modes -----------------------------------------------------------------------------------------------------------


def box_heat_modes(size: tuple[float, float, float], count: int, conductivity: float = 1.0) -> list[float]:
    """Lowest eigenvalues of a box with zero temperature on its sides: k pi^2 (i^2/a^2 + j^2/b^2 + l^2/c^2)."""
    a, b, c = size
    numbers = range(1, count + 2)
    values = sorted((i / a) ** 2 + (j / b) ** 2 + (k / c) ** 2 for i in numbers for j in numbers for k in numbers)
    return [conductivity * pi**2 * value for value in values[:count]]


def bar_modes(length: float, count: int, E: float = 1.0, density: float = 1.0) -> list[float]:
    """Squared angular frequencies of a bar held at one end, moving along its axis only: E/rho ((2k - 1) pi/(2 L))^2."""
    return [E / density * ((2 * k - 1) * pi / (2 * length)) ** 2 for k in range(1, count + 1)]
