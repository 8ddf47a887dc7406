"""Conductivity and elastic stiffness: constant, given by formulas, or read from the attributes of a domain.

Voigt order xx, yy, zz, yz, xz, xy with engineering shear, so that stress = C strain with C (6, 6) and

    isotropic   C = lambda m m^T + mu diag(2, 2, 2, 1, 1, 1),   m = (1, 1, 1, 0, 0, 0),
                lambda = E nu / ((1 + nu)(1 - 2 nu)),   mu = E / (2 (1 + nu)).

A coefficient is a number, an array ((3, 3) or (6, 6)), a :class:`~problems.formula.Formula` of that shape, any function
of points x (..., 3), or a :class:`~iga.field.Field`. Every one of them must be symmetric positive definite where it is
used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import sympy
from numpy.typing import ArrayLike, NDArray

from iga.chunk import chunks
from iga.domain import Domain
from iga.errors import InputError
from iga.field import Field
from problems.formula import Formula, from_array

Array: TypeAlias = NDArray[np.float64]
Function: TypeAlias = Callable[[Array], Array]
Scalar: TypeAlias = float | Formula | Field
Coefficient: TypeAlias = float | Array | Formula | Function | Field

SHAPES: dict[int, tuple[tuple[int, ...], ...]] = {1: ((),), 3: ((), (3, 3)), 6: ((6, 6),)}
"""Shapes that a coefficient may have at a point: of a scalar, of a conductivity, of a stiffness."""
VOLUMETRIC = np.zeros((6, 6))
VOLUMETRIC[:3, :3] = 1.0
SHEAR = np.diag([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])


def isotropic(E: Scalar, nu: float | Formula) -> Array | Formula | Field:
    """Return the stiffness (6, 6) of an isotropic material from Young's modulus E and Poisson's ratio nu.

    Raises
    ------
    InputError
        Unless E > 0 and -1 < nu < 0.5 (formulas are checked where they are evaluated).
    """
    if isinstance(nu, Field):
        raise InputError("material: nu cannot be an attribute; give lambda and mu as attributes instead")
    if not isinstance(nu, Formula):
        nu = number(nu, "material: nu")
        if nu == 0.5:
            raise InputError(
                "material: nu = 0.5 is incompressible, which this displacement form cannot represent; use nu < 0.5"
            )
        if not -1.0 < nu < 0.5:
            raise InputError(f"material: nu = {nu:g} is outside (-1, 0.5)")
    if not isinstance(E, Formula | Field):
        E = number(E, "material: E")
        if not E > 0:
            raise InputError(f"material: E = {E:g} must be positive")
    if isinstance(E, Formula) or isinstance(nu, Formula):
        if isinstance(E, Field):
            raise InputError("material: nu must be a number where E is an attribute")
        modulus, ratio = symbolic(E), symbolic(nu)
        lam, mu = modulus * ratio / ((1 + ratio) * (1 - 2 * ratio)), modulus / (2 * (1 + ratio))
        return from_array(VOLUMETRIC.astype(int) * lam + SHEAR.astype(int) * mu, "stiffness from E and nu")
    unit = nu / ((1 + nu) * (1 - 2 * nu)) * VOLUMETRIC + 0.5 / (1 + nu) * SHEAR
    if isinstance(E, Field):
        return Field(E.space, E.coefficients.reshape(-1, 1) * unit.reshape(1, 36))
    return E * unit


def lame(lam: Scalar, mu: Scalar) -> Array | Formula | Field:
    """Return the stiffness (6, 6) of an isotropic material from Lame's constants.

    Raises
    ------
    InputError
        Unless mu > 0 and 3 lambda + 2 mu > 0 (formulas are checked where they are evaluated).
    """
    if isinstance(lam, Formula) or isinstance(mu, Formula):
        if isinstance(lam, Field) or isinstance(mu, Field):
            raise InputError("material: lambda and mu must both be formulas or both attributes")
        entries = VOLUMETRIC.astype(int) * symbolic(lam) + SHEAR.astype(int) * symbolic(mu)
        return from_array(entries, "stiffness from lambda and mu")
    fields = [value for value in (lam, mu) if isinstance(value, Field)]
    if fields:
        n = len(fields[0].coefficients)
        parts = [
            value.coefficients.reshape(-1, 1)
            if isinstance(value, Field)
            else np.full((n, 1), number(value, "material"))
            for value in (lam, mu)
        ]
        return Field(fields[0].space, parts[0] * VOLUMETRIC.reshape(1, 36) + parts[1] * SHEAR.reshape(1, 36))
    lam, mu = number(lam, "material: lambda"), number(mu, "material: mu")
    if not mu > 0:
        raise InputError(f"material: mu = {mu:g} must be positive")
    if not 3 * lam + 2 * mu > 0:
        raise InputError(f"material: 3 lambda + 2 mu = {3 * lam + 2 * mu:g} must be positive")
    return lam * VOLUMETRIC + mu * SHEAR


def tensor(value: ArrayLike, size: int, name: str) -> Array:
    """Return a symmetric positive definite (size, size) array, or say which entry is wrong."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be {size} rows of {size} numbers") from None
    if array.shape != (size, size):
        raise InputError(f"{name} has shape {array.shape}, expected ({size}, {size})")
    if not np.isfinite(array).all():
        raise InputError(f"{name} has an entry that is not finite")
    difference = np.abs(array - array.T)
    if difference.max() > 1e-10 * np.abs(array).max():
        i, j = np.unravel_index(np.argmax(difference), difference.shape)
        raise InputError(
            f"{name} is not symmetric: entry ({i + 1}, {j + 1}) is {array[i, j]:g}, "
            f"({j + 1}, {i + 1}) is {array[j, i]:g}"
        )
    array = 0.5 * (array + array.T)
    require_positive(array, np.zeros(3), name, constant=True)
    return array


def number(value: object, name: str) -> float:
    """Return a finite float or raise."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise InputError(f"{name} must be a number, not {value!r}")
    if not np.isfinite(value):
        raise InputError(f"{name} = {value} is not finite")
    return float(value)


def symbolic(value: Any) -> sympy.Expr | NDArray[np.object_]:
    """Return a coefficient as SymPy expressions: one for a scalar, an object array otherwise."""
    if isinstance(value, Formula):
        return value.array() if value.shape else value.expressions[0]
    if callable(value) or isinstance(value, Field):
        raise InputError("an exact solution needs the material as numbers or formulas, which can be differentiated")
    array = np.asarray(value, dtype=float)
    entries = np.empty(array.shape, dtype=object)
    for k, entry in enumerate(array.reshape(-1)):
        entries.reshape(-1)[k] = sympy.Integer(int(entry)) if entry == int(entry) else sympy.Float(entry)
    return entries if array.shape else entries.item()


# --- positivity ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Checked:
    """A function of points that raises where its value has a wrong shape or is not symmetric positive definite."""

    function: Function
    name: str
    size: int

    def __call__(self, x: Array) -> Array:
        """Evaluate at x (..., 3)."""
        value = np.asarray(self.function(x), dtype=float)
        if value.shape not in [(), *(x.shape[:-1] + shape for shape in SHAPES[self.size])]:
            raise InputError(
                f"{self.name} has shape {value.shape} at points {x.shape}, expected {described(self.size)} at each"
            )
        require_positive(value, x, self.name)
        return value


def checked(coefficient: Any, name: str, size: int, domain: Domain) -> Any:
    """Return the coefficient in the form that integrands take, with its positivity checked now or on evaluation.

    Parameters
    ----------
    name : what it is, for messages
    size : 1 for a scalar (capacity, density), 3 for a conductivity, 6 for a stiffness; see `SHAPES`

    Raises
    ------
    InputError
        It has another shape, or is not positive (definite).
    """
    if isinstance(coefficient, Formula):
        if coefficient.shape not in SHAPES[size]:
            raise InputError(f"{name} has shape {coefficient.shape}, expected {described(size)}")
        if not coefficient.is_constant:
            return Checked(coefficient, name, size)
        coefficient = coefficient(np.zeros(3))
    if isinstance(coefficient, Field):
        components = int(np.prod(coefficient.coefficients.shape[1:], dtype=int))
        if components not in [int(np.prod(shape, dtype=int)) for shape in SHAPES[size]]:
            raise InputError(f"{name} as an attribute has {components} components, expected {described(size)}")
        check_field(coefficient, name, domain)
        return coefficient
    if callable(coefficient):
        return Checked(coefficient, name, size)
    if np.ndim(coefficient) == 0 and () in SHAPES[size]:
        value = number(coefficient if not isinstance(coefficient, np.ndarray) else coefficient.item(), name)
        if not value > 0:
            raise InputError(f"{name} = {value:g} must be positive")
        return value
    if size == 1:
        raise InputError(f"{name} has shape {np.shape(coefficient)}, expected {described(size)}")
    return tensor(coefficient, size, name)


def described(size: int) -> str:
    """Words for the shapes that a coefficient of this size may have."""
    return " or ".join("one number" if shape == () else f"{shape}" for shape in SHAPES[size])


def is_tensor(coefficient: Coefficient) -> bool:
    """Whether a checked coefficient is a matrix at each point rather than a number."""
    if isinstance(coefficient, Field):
        return coefficient.coefficients.size > len(coefficient.coefficients)
    if isinstance(coefficient, Checked) and isinstance(coefficient.function, Formula):
        return bool(coefficient.function.shape)
    return np.ndim(coefficient(np.zeros((1, 3)))) == 3 if callable(coefficient) else np.ndim(coefficient) == 2


def check_field(field: Field, name: str, domain: Domain) -> None:
    """Check a field-valued coefficient: by its coefficients where they suffice, else at the quadrature points."""
    coefficients = np.asarray(field.coefficients, dtype=float)
    side = {1: 1, 9: 3, 36: 6}[int(np.prod(coefficients.shape[1:], dtype=int))]
    bad = np.argwhere(~np.isfinite(coefficients))
    if len(bad):
        raise InputError(f"{name} is not finite at control point {bad[0, 0]}")
    # non-negative functions that sum to 1: definite coefficients give a definite field
    if side == 1 and coefficients.min() > 0:
        return
    if side > 1 and np.linalg.eigvalsh(coefficients.reshape(-1, side, side)).min() > 0:
        return
    for chunk in chunks(domain):
        value = chunk.at(coefficients.reshape(len(coefficients), -1))
        shape = value.shape[:2] if side == 1 else (*value.shape[:2], side, side)
        require_positive(value.reshape(shape), chunk.x, name)


def require_positive(value: Array, x: Array, name: str, constant: bool = False) -> None:
    """Raise unless value (...) or (..., k, k) at points x (..., 3) is positive (definite), naming the worst point."""
    if value.ndim <= np.ndim(x) - 1:
        lowest = value
        if (lowest > 0).all():
            return
        what = "must be positive"
    else:
        try:
            np.linalg.cholesky(value)
            return
        except np.linalg.LinAlgError:
            lowest = np.asarray(np.linalg.eigvalsh(value)[..., 0], dtype=np.float64)
        what = "must be positive definite, its smallest eigenvalue"
    worst = int(np.argmin(lowest))
    where = "" if constant else " at ({:.6g}, {:.6g}, {:.6g})".format(*np.asarray(x).reshape(-1, 3)[worst])
    raise InputError(
        f"{name} {what} is {np.reshape(lowest, -1)[worst]:.6g}{where}"
        if "eigen" in what
        else f"{name} {what}, it is {np.reshape(lowest, -1)[worst]:.6g}{where}"
    )
