r"""Preconditioned conjugate gradients that tell when rounding, not the method, ends progress.

They stop when the residual r and its preconditioned length have both fallen by the tolerance,

    |r| <= tol |f|    and    (r . M r)^(1/2) <= tol (f . M f)^(1/2),

the second being the energy norm of the error up to the quality of the preconditioner M, or when r has reached what
rounding allows: |r| <= 8 eps (| |K| |u| | + |f|), the componentwise backward error in the 2-norm. Residuals that decide
are computed anew from f - K u. Anything else raises `ConvergenceError`.

Axis letters: n unknown.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from iga.errors import ConvergenceError
from iga.kernels import sparse

Array = NDArray[np.float64]
Progress = Callable[[int, float], None]


def conjugate_gradients(
    apply: Callable[[Array], Array],
    f: Array,
    precondition: Callable[[Array], Array],
    u: Array,
    tolerance: float = 1e-13,
    max_iterations: int | None = None,
    progress: Progress | None = None,
    magnitude: Callable[[Array], Array] | None = None,
) -> tuple[Array, int, float]:
    """Preconditioned conjugate gradients, flexible in the preconditioner (Polak-Ribiere).

    Parameters
    ----------
    apply : product with the matrix.
    f, u : right-hand side and first guess, (n,).
    magnitude : product |K| |u| from u; without it the attainable residual is estimated as if it were |f| + |K u|.

    Returns
    -------
    The solution, the number of iterations, and the relative residual computed from it.

    Raises
    ------
    ConvergenceError : the tolerance is not reached, or the matrix or the preconditioner is not positive definite.
    """
    most = 2000 if max_iterations is None else max_iterations
    goal = float(np.linalg.norm(f))
    if goal == 0.0:
        return np.zeros_like(f), 0, 0.0
    u = u.copy()
    r = f - apply(u) if u.any() else f.copy()
    z = precondition(r)
    rz = float(r @ z)
    energy = rz if not u.any() else max(rz, float(f @ precondition(f)))
    p, best, count = z.copy(), np.inf, 0
    while True:
        while count < most:
            q = apply(p)
            curvature = float(p @ q)
            if not (curvature > 0 and rz > 0):
                if rz == 0.0 and not r.any():
                    break
                what = "matrix" if rz > 0 else "preconditioner"
                raise ConvergenceError(f"the {what} is not positive definite, as iteration {count} shows")
            old = r.copy()
            length = np.sqrt(sparse.advance(rz / curvature, p, q, u, r))
            count += 1
            if progress is not None:
                progress(count, length / goal)
            z = precondition(r)
            new = float(r @ z)
            if length <= tolerance * goal and new <= tolerance**2 * energy:
                break
            ratio = (new - float(old @ z)) / rz
            sparse.turn(ratio, z, p)
            rz = new
            if length <= 1e-3 * tolerance * goal:  # far below: rounding keeps the energy norm from following
                break
        r = f - apply(u)
        length = float(np.linalg.norm(r))
        if length <= tolerance * goal:
            return u, count, length / goal
        scale = goal + float(np.linalg.norm(magnitude(u) if magnitude is not None else apply(u)))
        if length <= 8 * np.finfo(float).eps * scale:
            return u, count, length / goal
        if count >= most or not length < 0.5 * best:
            raise ConvergenceError(
                f"conjugate gradients stopped after {count} iterations at relative residual {length / goal:.1e}, "
                f"not {tolerance:.1e}"
            )
        best = length
        z = precondition(r)
        rz = float(r @ z)
        p = z.copy()
