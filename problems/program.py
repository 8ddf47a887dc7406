"""Evaluation of symbolic expressions on arrays: a straight-line list of NumPy operations, nothing is run as code.

Common subexpressions are found once, integer powers become repeated products, and divisions stay divisions. ``step``,
``absolute``, ``smaller`` and ``larger`` are functions of SymPy that are differentiated almost everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import sympy
from numpy.typing import NDArray

from iga.errors import InputError

VARIABLES = ("x", "y", "z", "t")
SYMBOLS = dict(zip(VARIABLES, sympy.symbols(VARIABLES)))


class step(sympy.Function):  # noqa: N801 (a function, as SymPy's own)
    """1 where the argument is positive, 0 where negative, 1/2 at 0; its derivative is taken as 0."""

    nargs = 1

    def fdiff(self, argindex: int = 1) -> sympy.Expr:
        """Derivative in one argument."""
        return sympy.Integer(0)


class absolute(sympy.Function):  # noqa: N801
    """Absolute value, differentiated almost everywhere."""

    nargs = 1

    def fdiff(self, argindex: int = 1) -> sympy.Expr:
        """Derivative in one argument."""
        return 2 * step(self.args[0]) - 1


class smaller(sympy.Function):  # noqa: N801
    """Minimum of two arguments, differentiated almost everywhere."""

    nargs = 2

    def fdiff(self, argindex: int = 1) -> sympy.Expr:
        """Derivative in one argument."""
        a, b = self.args
        return step(b - a) if argindex == 1 else step(a - b)


class larger(sympy.Function):  # noqa: N801
    """Maximum of two arguments, differentiated almost everywhere."""

    nargs = 2

    def fdiff(self, argindex: int = 1) -> sympy.Expr:
        """Derivative in one argument."""
        a, b = self.args
        return step(a - b) if argindex == 1 else step(b - a)


# SymPy function -> NumPy function (cot, sec, csc appear when SymPy shifts arguments by pi/2)
EVALUATE: dict[type, Callable[..., NDArray[np.float64]]] = {
    sympy.sin: np.sin,
    sympy.cos: np.cos,
    sympy.tan: np.tan,
    sympy.cot: lambda a: 1.0 / np.tan(a),
    sympy.sec: lambda a: 1.0 / np.cos(a),
    sympy.csc: lambda a: 1.0 / np.sin(a),
    sympy.asin: np.arcsin,
    sympy.acos: np.arccos,
    sympy.atan: np.arctan,
    sympy.atan2: np.arctan2,
    sympy.sinh: np.sinh,
    sympy.cosh: np.cosh,
    sympy.tanh: np.tanh,
    sympy.exp: np.exp,
    sympy.log: np.log,
    sympy.Abs: np.abs,
    sympy.sign: np.sign,
    absolute: np.abs,
    smaller: np.minimum,
    larger: np.maximum,
    step: lambda a: np.heaviside(a, 0.5),
}


Operation = Callable[..., "NDArray[np.float64] | float"]


@dataclass(frozen=True)
class Program:
    """Straight-line list of NumPy operations: slots 0-3 hold x, y, z, t, slot k the k-th result."""

    constants: tuple[tuple[int, float], ...]
    steps: tuple[tuple[int, Operation, tuple[int, ...]], ...]
    results: tuple[int, ...]
    size: int

    def __call__(self, x: NDArray[np.float64], t: float) -> NDArray[np.float64]:
        """Evaluate at x (..., 3): array (..., entries)."""
        slots: list[NDArray[np.float64] | float] = [0.0] * self.size
        slots[0], slots[1], slots[2], slots[3] = x[..., 0], x[..., 1], x[..., 2], float(t)
        for slot, value in self.constants:
            slots[slot] = value
        with np.errstate(all="ignore"):
            for slot, operation, arguments in self.steps:
                slots[slot] = operation(*(slots[k] for k in arguments))
        result = np.empty((*x.shape[:-1], len(self.results)))
        for entry, slot in enumerate(self.results):
            result[..., entry] = slots[slot]
        return result


def compile_program(expressions: Sequence[sympy.Expr], text: str) -> Program:
    """Order the operations of the expressions, each distinct subexpression once."""
    shared, reduced = sympy.cse(list(expressions), order="none") if len(expressions) > 1 else ([], list(expressions))
    slot_of: dict[sympy.Expr, int] = {SYMBOLS[name]: k for k, name in enumerate(VARIABLES)}
    constants: list[tuple[int, float]] = []
    steps: list[tuple[int, Operation, tuple[int, ...]]] = []
    size = len(VARIABLES)

    def place(expression: sympy.Expr) -> int:
        nonlocal size
        if expression in slot_of:
            return slot_of[expression]
        if expression.is_number:
            constants.append((size, float(expression)))
        else:
            operation, arguments = operation_of(expression)
            inputs = tuple(place(argument) for argument in arguments)
            steps.append((size, operation, inputs))
        slot_of[expression] = size
        size += 1
        return size - 1

    def operation_of(expression: sympy.Expr) -> tuple[Operation, tuple[sympy.Expr, ...]]:
        if expression.is_Add:
            return add, expression.args
        if expression.is_Mul:
            below = [a for a in expression.args if a.is_Pow and a.exp.is_number and a.exp.could_extract_minus_sign()]
            above = [a for a in expression.args if a not in below]
            if below and above:
                return np.divide, (sympy.Mul(*above), sympy.Mul(*(1 / a for a in below)))
            return multiply, expression.args
        if isinstance(expression, sympy.exp):
            return np.exp, (expression.args[0],)
        if expression.is_Pow:
            base, exponent = expression.args
            if exponent.is_Integer:
                return integer_power(int(exponent)), (base,)
            if exponent == sympy.Rational(1, 2):
                return np.sqrt, (base,)
            if base == sympy.E:
                return np.exp, (exponent,)
            return np.power, (base, exponent)
        if expression.func in EVALUATE:
            return EVALUATE[expression.func], expression.args
        raise InputError(f"formula '{text}' leads to {expression.func}, which cannot be evaluated")

    for symbol, expression in shared:
        slot_of[symbol] = place(expression)
    results = tuple(place(expression) for expression in reduced)
    return Program(tuple(constants), tuple(steps), results, size)


def add(*values: NDArray[np.float64] | float) -> NDArray[np.float64] | float:
    """Sum of the arguments."""
    return sum(values[1:], values[0])


def multiply(*values: NDArray[np.float64] | float) -> NDArray[np.float64] | float:
    """Product of the arguments."""
    return math.prod(values)


def integer_power(exponent: int) -> Operation:
    """Return a function that raises to an integer power by repeated squaring (much faster than ``np.power``)."""

    def raise_to(base: NDArray[np.float64] | float) -> NDArray[np.float64] | float:
        result, square, left = None, base, abs(exponent)
        while left:
            if left & 1:
                result = square if result is None else result * square
            left >>= 1
            if left:
                square = square * square
        if result is None:
            return 1.0
        return result if exponent > 0 else np.divide(1.0, result)

    return raise_to
