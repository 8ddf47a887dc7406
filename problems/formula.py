"""Formulas in x, y, z and t: parsed, differentiated exactly, evaluated on arrays. Never run as code.

A text such as ``sin(pi*x)*exp(-t) + 0.5*y**2`` is read by Python's grammar alone (:mod:`ast`), each node is looked up
in a closed list (numbers, ``+ - * / **``, unary signs, the functions and constants below) and becomes a SymPy
expression built by constructors. Derivatives are SymPy's; evaluation walks a straight-line list of NumPy operations,
made once per formula after elimination of common subexpressions.

Functions: sin cos tan asin acos atan atan2 sinh cosh tanh exp log sqrt abs min max. Constants: pi, e.
``abs``, ``min`` and ``max`` are differentiated almost everywhere.

Limits keep the cost bounded whatever the text: length, nesting, number of operations, size of numbers, integer
exponents.
"""

from __future__ import annotations

import ast
import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import sympy
from numpy.typing import ArrayLike, NDArray

from iga.errors import InputError
from problems.program import SYMBOLS, VARIABLES, Program, absolute, compile_program, larger, smaller

MAX_LENGTH, MAX_PARENTHESES, MAX_DEPTH, MAX_NODES, MAX_POWER = 1000, 40, 200, 400, 64

SPACE = tuple(SYMBOLS[name] for name in "xyz")


# name in the text -> (SymPy constructor, value at numbers, number of arguments)
FUNCTIONS: dict[str, tuple[Callable[..., sympy.Expr], Callable[..., float], int]] = {
    "sin": (sympy.sin, math.sin, 1),
    "cos": (sympy.cos, math.cos, 1),
    "tan": (sympy.tan, math.tan, 1),
    "asin": (sympy.asin, math.asin, 1),
    "acos": (sympy.acos, math.acos, 1),
    "atan": (sympy.atan, math.atan, 1),
    "atan2": (sympy.atan2, math.atan2, 2),
    "sinh": (sympy.sinh, math.sinh, 1),
    "cosh": (sympy.cosh, math.cosh, 1),
    "tanh": (sympy.tanh, math.tanh, 1),
    "exp": (sympy.exp, math.exp, 1),
    "log": (sympy.log, math.log, 1),
    "sqrt": (sympy.sqrt, math.sqrt, 1),
    "abs": (absolute, abs, 1),
    "min": (smaller, min, 2),
    "max": (larger, max, 2),
}
CONSTANTS = {"pi": sympy.pi, "e": sympy.E}


@dataclass(frozen=True)
class Formula:
    """An array of expressions in x, y, z, t, as a function of points.

    Attributes
    ----------
    text : what the user wrote, or a description; used in error messages
    expressions : the entries, in C order
    shape : () for a scalar, (3,) for a vector, (3, 3) for a tensor, ...
    """

    text: str
    expressions: tuple[sympy.Expr, ...]
    shape: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if len(self.expressions) != math.prod(self.shape):
            raise InputError(f"formula '{self.text}' has {len(self.expressions)} entries, not {math.prod(self.shape)}")

    @cached_property
    def _program(self) -> Program:
        return compile_program(self.expressions, shorten(self.text))

    def __call__(self, x: ArrayLike, t: float = 0.0) -> NDArray[np.float64]:
        """Evaluate at points x (..., 3) and time t: array (..., *shape).

        Raises
        ------
        InputError
            Where the value is not a finite real number; the message names the point.
        """
        x = np.asarray(x, dtype=float)
        value = self._program(x, t)
        if not np.isfinite(value).all():
            flat = np.isfinite(value).reshape(-1, len(self.expressions)).all(axis=1)
            where = ", ".join(f"{c:.6g}" for c in x.reshape(-1, 3)[np.argmin(flat)])
            raise InputError(f"formula '{shorten(self.text)}' has no finite real value at ({where})")
        return value.reshape(x.shape[:-1] + self.shape)

    @property
    def depends_on_time(self) -> bool:
        """Whether t appears."""
        return any(SYMBOLS["t"] in expression.free_symbols for expression in self.expressions)

    @property
    def is_constant(self) -> bool:
        """Whether none of x, y, z, t appears."""
        return not any(expression.free_symbols for expression in self.expressions)

    def at(self, t: float) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
        """Return the function of x (..., 3) alone at time t."""
        return lambda x: self(x, t)

    def gradient(self) -> Formula:
        """Return the derivatives in x, y, z as a last axis: shape (*shape, 3), entry [..., j] = d/dx_j."""
        entries = tuple(sympy.diff(u, variable) for u in self.expressions for variable in SPACE)
        return Formula(f"gradient of {self.text}", entries, (*self.shape, 3))

    def rate(self) -> Formula:
        """Return the derivative in t, same shape."""
        return Formula(
            f"time derivative of {self.text}", tuple(u.diff(SYMBOLS["t"]) for u in self.expressions), self.shape
        )

    def array(self) -> NDArray[np.object_]:
        """Return the expressions as an object array of the formula's shape, for further symbolic work."""
        entries = np.empty(len(self.expressions), dtype=object)
        entries[:] = self.expressions
        return entries.reshape(self.shape)


def from_array(entries: NDArray[np.object_] | sympy.Expr, text: str) -> Formula:
    """Make a formula of an object array of SymPy expressions, or of one expression."""
    array = np.asarray(entries, dtype=object)
    return Formula(text, tuple(sympy.sympify(entry) for entry in array.reshape(-1)), array.shape)


def parse(text: str, variables: Sequence[str] = VARIABLES) -> Formula:
    """Read one scalar formula.

    Raises
    ------
    InputError
        In one line, with the column, for anything outside the closed list of the module's docstring.
    """
    return Formula(text, (parse_expression(text, variables),))


def parse_vector(text: str, components: int = 3, variables: Sequence[str] = VARIABLES) -> Formula:
    """Read formulas separated by ``;``: shape () when one is asked for, (components,) otherwise."""
    if not isinstance(text, str):
        raise InputError(f"a formula is a text, not {text!r}")
    parts = text.split(";")
    if len(parts) != components:
        wanted = "one formula" if components == 1 else f"{components} formulas separated by ';'"
        raise InputError(f"formula '{shorten(text)}': {len(parts)} given, {wanted} expected")
    starts = [0, *np.cumsum([len(part) + 1 for part in parts])]
    entries = tuple(parse_expression(part, variables, int(start)) for part, start in zip(parts, starts))
    return Formula(text, entries, () if components == 1 else (components,))


def shorten(text: str, width: int = 60) -> str:
    """Return the text on one line, cut to the width."""
    line = "".join(c if c.isprintable() else "?" for c in text)
    return line if len(line) <= width else line[: width - 3] + "..."


def parse_expression(text: str, variables: Sequence[str] = VARIABLES, offset: int = 0) -> sympy.Expr:
    """Read one scalar formula into a SymPy expression; columns in messages are counted from 1 + offset."""
    if not isinstance(text, str):
        raise InputError(f"a formula must be text, not {type(text).__name__}")

    def refuse(message: str, column: int = 0) -> InputError:
        return InputError(f"formula '{shorten(text.strip())}', column {column + offset + 1}: {message}")

    if len(text) > MAX_LENGTH:
        raise refuse(f"{len(text)} characters, at most {MAX_LENGTH} are read", MAX_LENGTH)
    for column, character in enumerate(text):
        if not character.isascii() or not (character.isprintable() or character in " \t"):
            raise refuse(f"character {character!r} cannot be part of a formula", column)
    lead = len(text) - len(text.lstrip())
    if not text.strip():
        raise refuse("the formula is empty")
    depth = np.cumsum([(c == "(") - (c == ")") for c in text])
    if depth.max() > MAX_PARENTHESES:
        raise refuse(f"more than {MAX_PARENTHESES} nested parentheses", int(np.argmax(depth > MAX_PARENTHESES)))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(text.strip(), mode="eval")
    except SyntaxError as error:
        raise refuse(f"{error.msg}", lead + (error.offset or len(text.strip()) + 1) - 1) from None
    except (ValueError, MemoryError, RecursionError):
        raise refuse("too deeply nested to be read") from None
    budget = [MAX_NODES]

    def visit(node: ast.expr, level: int) -> sympy.Expr:
        def bad(message: str, at: ast.expr = node) -> InputError:
            return refuse(message, lead + at.col_offset)

        budget[0] -= 1
        if budget[0] < 0:
            raise bad(f"more than {MAX_NODES} operations")
        if level > MAX_DEPTH:
            raise bad(f"more than {MAX_DEPTH} nested operations")
        try:
            return checked(convert(node, level, bad), bad)
        except (ZeroDivisionError, ValueError, OverflowError, TypeError, RecursionError) as error:
            if isinstance(error, InputError):
                raise
            raise bad("no finite real value") from None

    def convert(node: ast.expr, level: int, bad: Callable[..., InputError]) -> sympy.Expr:
        match node:
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                return literal(value, bad)
            case ast.Name(id=name):
                if name in variables:
                    return SYMBOLS[name]
                if name in CONSTANTS:
                    return CONSTANTS[name]
                if name in FUNCTIONS:
                    raise bad(f"function {name} needs its argument in parentheses")
                known = ", ".join((*variables, *CONSTANTS))
                raise bad(f"unknown name {shorten(name, 20)!r} (known: {known})")
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return -visit(operand, level + 1)
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return visit(operand, level + 1)
            case ast.BinOp(left=left, op=op, right=right):
                a, b = visit(left, level + 1), visit(right, level + 1)
                match op:
                    case ast.Add():
                        return a + b
                    case ast.Sub():
                        return a - b
                    case ast.Mult():
                        return a * b
                    case ast.Div():
                        if b == 0:
                            raise bad("division by zero", right)
                        return a / b
                    case ast.Pow():
                        return power(a, b, lambda message: bad(message, right))
                    case ast.BitXor():
                        raise bad("'^' is no operation here, powers are written '**'", right)
                raise bad("only + - * / ** are allowed")
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                if name not in FUNCTIONS:
                    raise bad(f"unknown function {shorten(name, 20)!r} (known: {', '.join(FUNCTIONS)})")
                make, at_numbers, count = FUNCTIONS[name]
                if len(arguments) != count or any(isinstance(a, ast.Starred) for a in arguments):
                    raise bad(f"function {name} takes {count} argument{'s' if count > 1 else ''}")
                values = [visit(a, level + 1) for a in arguments]
                if all(v.is_number for v in values):
                    return literal(at_numbers(*(float(v) for v in values)), bad)
                return make(*values)
        raise bad("only numbers, variables, + - * / **, parentheses and the listed functions are allowed")

    return visit(tree.body, 0)


def literal(value: float, refuse: Callable[[str], InputError]) -> sympy.Expr:
    """Return a number: short decimals exactly, as rationals, so that 0.1*10 is 1; the rest as doubles."""
    if isinstance(value, int) and abs(value) < 2**53:
        return sympy.Integer(value)
    try:
        value = float(value)
    except OverflowError:
        value = math.inf
    if not abs(value) < 1e200:
        raise refuse("the number is too large")
    if value == 0 or 1e-9 < abs(value) < 1e9:
        exact = sympy.Rational(repr(value))
        if exact.q < 10**9:
            return exact
    return sympy.Float(value)


def power(base: sympy.Expr, exponent: sympy.Expr, refuse: Callable[[str], InputError]) -> sympy.Expr:
    """Return base ** exponent with bounded constants."""
    if exponent.is_number:
        size = float(exponent)
        if abs(size) > MAX_POWER:
            raise refuse(f"the exponent is larger than {MAX_POWER}")
        if size == int(size):
            exponent = sympy.Integer(int(size))
        if base == 0 and size < 0:
            raise refuse("division by zero")
        if base.is_number:
            value = float(base) ** size
            if isinstance(value, complex):
                raise refuse("a root of a negative number")
            if not (base.is_Integer and exponent.is_Integer and size >= 0 and abs(value) < 2**53):
                return literal(value, refuse)
    return base**exponent


def checked(expression: sympy.Expr, refuse: Callable[[str], InputError]) -> sympy.Expr:
    """Refuse what is not finite and real, and round constants that grow too long."""
    if expression.has(sympy.zoo, sympy.nan, sympy.oo, -sympy.oo, sympy.I):
        raise refuse("no finite real value")
    if expression.is_Rational and max(abs(expression.p), expression.q) >= 2**53:
        return literal(expression.p / expression.q, refuse)
    if expression.is_Number and not abs(expression) < 1e200:
        raise refuse("the number is too large")
    if expression.is_Pow and expression.exp.is_number and abs(expression.exp) > MAX_POWER**2:
        raise refuse(f"nested powers multiply to more than {MAX_POWER**2}")
    return expression
