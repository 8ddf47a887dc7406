"""Formulas: what is read, what is refused and where, derivatives, and that no text does anything else."""

from __future__ import annotations

import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

from iga.errors import InputError
from problems.formula import MAX_LENGTH, parse, parse_vector

POINTS = np.random.default_rng(71).uniform(0.1, 0.9, (11, 3))
x, y, z = POINTS.T

VALUES = [
    ("1", 0 * x + 1),
    ("0.1*10*x", x),
    ("x - -y", x + y),
    ("+x/(1 + y)", x / (1 + y)),
    ("2**3*x**2 - x**-2", 8 * x**2 - x**-2),
    ("x**0.5 + sqrt(y)", np.sqrt(x) + np.sqrt(y)),
    ("e**x - exp(x) + pi", 0 * x + np.pi),
    ("sin(pi*x)*cos(y)*tan(z)", np.sin(np.pi * x) * np.cos(y) * np.tan(z)),
    ("asin(x) + acos(y) + atan(z) + atan2(y, x)", np.arcsin(x) + np.arccos(y) + np.arctan(z) + np.arctan2(y, x)),
    ("sinh(x) + cosh(y)*tanh(z) + log(x)", np.sinh(x) + np.cosh(y) * np.tanh(z) + np.log(x)),
    ("abs(x - 0.5) + min(x, y) - max(y, z)", np.abs(x - 0.5) + np.minimum(x, y) - np.maximum(y, z)),
    ("x**y + (x + y)**(1/3)", x**y + np.cbrt(x + y)),
    ("t*x", 0.25 * x),
    ("tan(x + pi/2)", np.tan(x + np.pi / 2)),
    ("sqrt(2)**2*x + sin(0.5)", 2 * x + np.sin(0.5)),
    (" + ".join(["x"] * 90), 90 * x),
]


@pytest.mark.parametrize(("text", "value"), VALUES, ids=[v[0][:30] for v in VALUES])
def test_values_and_derivatives(text: str, value: np.ndarray) -> None:
    formula = parse(text)
    np.testing.assert_allclose(formula(POINTS, 0.25), value, rtol=1e-13, atol=1e-15)
    h = 1e-5
    for j, step in enumerate(h * np.eye(3)):
        difference = (formula(POINTS + step, 0.25) - formula(POINTS - step, 0.25)) / (2 * h)
        np.testing.assert_allclose(formula.gradient()(POINTS, 0.25)[:, j], difference, rtol=1e-6, atol=1e-6)
    difference = (formula(POINTS, 0.25 + h) - formula(POINTS, 0.25 - h)) / (2 * h)
    np.testing.assert_allclose(formula.rate()(POINTS, 0.25), difference, atol=1e-6)


def test_gradient_is_the_symbolic_derivative() -> None:
    formula = parse("sin(x*y)*exp(-z) + x**3")
    a, b, c = sympy.symbols("x y z")
    exact = sympy.sin(a * b) * sympy.exp(-c) + a**3
    assert list(formula.gradient().expressions) == [exact.diff(v) for v in (a, b, c)]


def test_axes() -> None:
    formula = parse_vector("x; 2; y*z")
    assert formula(POINTS).shape == (11, 3)
    assert formula(POINTS.reshape(11, 1, 3)).shape == (11, 1, 3)
    assert formula(POINTS[0]).shape == (3,)
    gradient = formula.gradient()
    assert gradient(POINTS).shape == (11, 3, 3)
    np.testing.assert_allclose(gradient(POINTS)[:, 2], np.stack([0 * x, z, y], axis=1))
    assert parse_vector("x", 1).shape == ()


REFUSED = [
    ("", 1, "empty"),
    ("x +", 4, "invalid syntax"),
    ("sin(x", 4, "never closed"),
    ("2*foo(x)", 3, "unknown function 'foo'"),
    ("x + w", 5, "unknown name 'w'"),
    ("sin(x, y)", 1, "takes 1 argument"),
    ("sin + 1", 1, "needs its argument"),
    ("x^2", 3, "powers are written '**'"),
    ("x/0", 3, "division by zero"),
    ("x/(y - y)", 4, "division by zero"),
    ("1 + sqrt(-1)", 5, "no finite real value"),
    ("(0 - 8)**(1/3)", 11, "root of a negative number"),
    ("x**65", 4, "exponent is larger"),
    ("9**9**9**9", 7, "exponent is larger"),
    ("((x**64)**64)**64", 1, "nested powers"),
    ("exp(exp(exp(100)))", 5, "no finite real value"),
    ("1e999", 1, "too large"),
    ("x if y else z", 1, "only numbers"),
    ("__import__('os').system('true')", 1, "only numbers"),
    ("(1).__class__", 1, "only numbers"),
    ("[x for x in (1,)]", 1, "only numbers"),
    ("lambda: x", 1, "only numbers"),
    ("True", 1, "only numbers"),
    ("1j", 1, "only numbers"),
    ("x < y", 1, "only numbers"),
    ("x\ny", 2, "cannot be part"),
    ("x\u00b2", 2, "cannot be part"),
    ("(" * 60 + "x" + ")" * 60, 41, "nested parentheses"),
    ("-" * 500 + "x", 202, "nested operations"),
    ("x" * (MAX_LENGTH + 1), MAX_LENGTH + 1, "characters"),
]


@pytest.mark.parametrize(("text", "column", "words"), REFUSED, ids=[repr(r[0][:25]) for r in REFUSED])
def test_refusals_name_the_column(text: str, column: int, words: str) -> None:
    with pytest.raises(InputError) as caught:
        parse(text)
    message = str(caught.value)
    assert words in message
    assert f"column {column}:" in message
    assert "\n" not in message


def test_components_are_counted() -> None:
    with pytest.raises(InputError, match="2 given, 3 formulas"):
        parse_vector("x;y")
    with pytest.raises(InputError, match="column 5: unknown name 'q'"):
        parse_vector("x;y;q")
    with pytest.raises(InputError, match="a formula is a text, not 3"):
        parse_vector(3, 1)


def test_variables_can_be_closed() -> None:
    with pytest.raises(InputError, match="unknown name 't'"):
        parse("x*t", variables=("x", "y", "z"))


def test_value_that_is_not_finite_names_the_point() -> None:
    with pytest.raises(InputError, match=r"no finite real value at \(0, 0.5, 1\)"):
        parse("log(x)")(np.array([[1.0, 2.0, 3.0], [0.0, 0.5, 1.0]]))


ATOMS = st.sampled_from(["x", "y", "z", "t", "pi", "e", "0", "1", "2", "0.5", "1e-3", "64", "7.25"])


def combine(parts: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    binary = st.builds("({}{}{})".format, parts, st.sampled_from(["+", "-", "*", "/", "**"]), parts)
    names = ["sin", "cos", "tan", "exp", "log", "sqrt", "abs", "sinh", "tanh", "atan"]
    return st.one_of(binary, st.builds("{}({})".format, st.sampled_from(names), parts), st.builds("-{}".format, parts))


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.recursive(ATOMS, combine, max_leaves=8))
def test_generated_formulas_agree_with_python(text: str) -> None:
    """The grammar's own sentences: the value is Python's wherever Python has one."""
    try:
        formula = parse(text)
        values = formula(POINTS[:1], 0.3)
        formula.gradient()
    except InputError as error:
        assert "\n" not in str(error)
        return
    names = {n: getattr(np, n) for n in ("sin", "cos", "tan", "exp", "log", "sqrt", "abs", "sinh", "tanh")}
    names |= {"atan": np.arctan, "pi": np.pi, "e": np.e, "x": x[0], "y": y[0], "z": z[0], "t": np.float64(0.3)}
    with np.errstate(all="ignore"):
        expected = eval(text, {"__builtins__": {}}, names)  # the test's own sentence, not user text
    if np.isfinite(expected) and abs(expected) < 1e6:
        # cancellation inside may be exact in the formula and rounded in Python
        assert abs(values[0] - expected) <= 1e-6 * max(1.0, abs(expected)) or not np.isfinite(values[0])


@settings(max_examples=400, deadline=None, derandomize=True)
@given(st.text(alphabet="xyzt0123456789.e+-*/() ,;_[]{}'\"<>=:sincoexplgqrtabm\\\n\t\x00é", max_size=40))
def test_any_text_is_read_or_refused_in_one_line(text: str) -> None:
    try:
        parse_vector(text, 1)
    except InputError as error:
        assert "\n" not in str(error)
        assert "column" in str(error) or "expected" in str(error)
