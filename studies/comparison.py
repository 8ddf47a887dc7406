"""Comparison of a study's table with its committed baseline: numbers, rates, bounds, and rows that came or went."""

from __future__ import annotations

import math
from dataclasses import dataclass

from iga.errors import InputError
from studies.table import RATE_WINDOW, Column, Table, Value, field_text


@dataclass(frozen=True)
class Difference:
    """One place where a table departs from what it should be."""

    row: str
    column: str
    expected: str
    got: str
    allowed: str

    def __str__(self) -> str:
        """One line."""
        return f"{self.row}: {self.column}: expected {self.expected}, got {self.got} (allowed: {self.allowed})"


def compare(got: Table, baseline: Table) -> list[Difference]:
    """Compare a table with its baseline: numbers within the column's tolerance, rates within 0.1, bounds kept.

    Rows are matched by their key columns, or by position where there are none.
    """
    differences = bounds(got)
    expected_rows, got_rows = _keyed(baseline), _keyed(got)
    for key in expected_rows.keys() - got_rows.keys():
        differences.append(Difference(key, "row", "present", "missing", "every row of the baseline"))
    for key in got_rows.keys() - expected_rows.keys():
        differences.append(Difference(key, "row", "absent", "present", "rows of the baseline only"))
    for key in [key for key in got_rows if key in expected_rows]:
        for column, value, expected in zip(got.columns, got_rows[key], expected_rows[key], strict=True):
            differences += _compare_value(key, column, value, expected)
    return differences + _compare_rates(got, baseline)


def bounds(got: Table) -> list[Difference]:
    """Values above the `at_most` of their column."""
    found = []
    for key, row in _keyed(got).items():
        for column, value in zip(got.columns, row, strict=True):
            if column.at_most is None or value is None or isinstance(value, str):
                continue
            if not value <= column.at_most:
                bound = f"at most {column.at_most:g}"
                found.append(Difference(key, column.name, bound, f"{value:.6g}", bound))
    return found


def _keyed(made: Table) -> dict[str, tuple[Value, ...]]:
    keys = [at for at, column in enumerate(made.columns) if column.key]
    named: dict[str, tuple[Value, ...]] = {}
    for number, row in enumerate(made.rows):
        name = ", ".join(f"{made.columns[at].name} = {row[at]}" for at in keys) if keys else f"row {number}"
        if name in named:
            raise InputError(f"table {made.name!r}: two rows have the key {name}")
        named[name] = row
    return named


def _compare_value(key: str, column: Column, got: Value, expected: Value) -> list[Difference]:
    if column.kind == "time":
        return []
    if got is None or expected is None:
        if got is expected:
            return []
        return [Difference(key, column.name, field_text(expected) or "–", field_text(got) or "–", "equal")]
    if isinstance(got, str) or isinstance(expected, str):
        return [] if got == expected else [Difference(key, column.name, str(expected), str(got), "equal")]
    if math.isnan(expected) and math.isnan(got):
        return []
    held_by_bound = column.at_most is not None and column.relative == 0.0 and column.absolute == 0.0
    # The baseline holds nine digits, so even an exact number may be that far off.
    allowed = column.absolute + max(column.relative, 1e-8 if column.kind == "float" else 0.0) * abs(expected)
    if held_by_bound or got == expected or abs(got - expected) <= allowed:
        return []
    return [Difference(key, column.name, f"{expected:.6g}", f"{got:.6g}", f"± {allowed:.2g}")]


def _compare_rates(got: Table, baseline: Table) -> list[Difference]:
    found = []
    expected = {rate.name: rate for rate in baseline.rates()}
    for rate in got.rates():
        if rate.name not in expected:
            continue  # its rows are new or empty, which has been said
        known = expected[rate.name]
        for word, value, should in (("fit", rate.fit, known.fit), ("last pair", rate.last, known.last)):
            if not abs(value - should) <= RATE_WINDOW:
                row = f"rate of {rate.name}"
                found.append(Difference(row, word, f"{should:.3f}", f"{value:.3f}", f"± {RATE_WINDOW}"))
    return found
