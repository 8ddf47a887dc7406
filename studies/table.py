"""Tables of studies: typed columns, rows, observed rates; in CSV, in JSON and on the terminal.

A rate is the exponent r in ``y = c x^r``, observed over the rows of one group in two ways: the slope of the
least-squares line through all points (log x, log y), and the slope of the last pair alone. Rates are computed from
rows, never stored, so a CSV file holds a table completely.

CSV layout: one header line with the column names, one line per row; numbers with nine significant digits, an empty
field where there is no value.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from iga.errors import FormatError, InputError

if TYPE_CHECKING:
    from rich.table import Table as RichTable

Kind = Literal["text", "int", "float", "time"]
Value = str | int | float | None
RATE_WINDOW = 0.1
"""How far an observed rate may be from the baseline's."""


@dataclass(frozen=True)
class Column:
    """One column: what its values are and how far they may be from the baseline.

    Attributes
    ----------
    name : heading, also the key in JSON.
    kind : "text", "int", "float", or "time" (seconds or anything else that depends on the machine: never compared).
    unit : shown under the heading.
    relative, absolute : a float passes if ``|got - expected| <= absolute + relative |expected|``; integers and text
        must be equal unless a tolerance is given (integers only).
    at_most : upper bound that every value must keep whatever the baseline says, or None. A column with `at_most` and no
        tolerance is held by its bound alone (round-off-sized numbers, which no baseline can predict).
    format : format specification in printed tables.
    key : the column names its row (with the other key columns) when two tables are compared.
    """

    name: str
    kind: Kind = "float"
    unit: str = ""
    relative: float = 0.0
    absolute: float = 0.0
    at_most: float | None = None
    format: str = ""
    key: bool = False


@dataclass(frozen=True)
class Slope:
    """What to observe: the exponent of `y` over `x`, one for every combination of values in the columns `by`.

    `expected` is the exponent theory gives (a number or a column that holds it), `least` the number of levels it takes.
    """

    x: str
    y: str
    by: tuple[str, ...] = ()
    expected: float | str | None = None
    least: int = 3


@dataclass(frozen=True)
class Rate:
    """An observed exponent: `fit` by least squares over all `levels`, `last` over the last pair."""

    group: tuple[tuple[str, Value], ...]
    x: str
    y: str
    levels: int
    fit: float
    last: float
    expected: float | None = None

    @property
    def name(self) -> str:
        """Words for messages: ``l2_error over h, degree = 2``."""
        return ", ".join([f"{self.y} over {self.x}", *(f"{k} = {v}" for k, v in self.group)])


@dataclass(frozen=True)
class Table:
    """Rows under typed columns, and the slopes to observe in them. Make it with `table`, which checks it."""

    name: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Value, ...], ...]
    slopes: tuple[Slope, ...] = ()

    def column(self, name: str) -> list[Value]:
        """Values of one column, from the first row to the last."""
        at = _index(self, name)
        return [row[at] for row in self.rows]

    def records(self) -> list[dict[str, Value]]:
        """Rows as mappings by column name."""
        names = [column.name for column in self.columns]
        return [dict(zip(names, row, strict=True)) for row in self.rows]

    def rates(self) -> tuple[Rate, ...]:
        """All observed rates."""
        return tuple(rate for slope in self.slopes for rate in _observe(self, slope))


def numbers(records: Iterable[Mapping[str, Value]], name: str) -> list[float]:
    """Numbers under one name in some rows; NaN where there is none.

    Raises
    ------
    InputError : there is a text instead.
    """
    found = []
    for record in records:
        value = record[name]
        if isinstance(value, str):
            raise InputError(f"column {name!r} has texts ({value!r}), no numbers")
        found.append(math.nan if value is None else float(value))
    return found


def table(
    name: str,
    columns: Sequence[Column],
    rows: Iterable[Sequence[Value] | Mapping[str, Value]],
    slopes: Sequence[Slope] = (),
) -> Table:
    """Make a table and check it.

    Parameters
    ----------
    name : used in titles and messages.
    columns, slopes : what there is.
    rows : each one value per column, in order, or a mapping by column name (missing names are empty).

    Raises
    ------
    InputError : a value of the wrong kind, a row of the wrong length, an unknown column.
    """
    names = [column.name for column in columns]
    if len(set(names)) != len(names):
        raise InputError(f"table {name!r}: two columns share a name: {names}")
    made = []
    for number, row in enumerate(rows):
        if isinstance(row, Mapping):
            unknown = set(row) - set(names)
            if unknown:
                raise InputError(f"table {name!r}, row {number}: no column {sorted(unknown)[0]!r}")
            row = [row.get(key) for key in names]
        if len(row) != len(columns):
            raise InputError(f"table {name!r}, row {number}: {len(row)} values for {len(columns)} columns")
        made.append(tuple(_typed(name, number, c, value) for c, value in zip(columns, row, strict=True)))
    done = Table(name, tuple(columns), tuple(made), tuple(slopes))
    for slope in slopes:
        for key in (slope.x, slope.y, *slope.by, *([slope.expected] if isinstance(slope.expected, str) else [])):
            _index(done, key)
    return done


def _typed(name: str, number: int, column: Column, value: Any) -> Value:
    """A value as its column's kind says; messages name table, row and column."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None:
        return None
    where = f"table {name!r}, row {number}, column {column.name!r}"
    if column.kind == "text":
        if not isinstance(value, str):
            raise InputError(f"{where}: {value!r} is no text")
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where}: {value!r} is no number")
    if column.kind == "int":
        if not math.isfinite(value) or value != int(value):
            raise InputError(f"{where}: {value!r} is no whole number")
        return int(value)
    return float(value)


def _index(made: Table, name: str) -> int:
    """Place of a column."""
    for at, column in enumerate(made.columns):
        if column.name == name:
            return at
    raise InputError(f"table {made.name!r} has no column {name!r}")


def _observe(made: Table, slope: Slope) -> list[Rate]:
    """Rates of one slope, over the rows whose x and y are positive."""
    groups: dict[tuple[tuple[str, Value], ...], list[tuple[float, float, float | None]]] = {}
    x, y = _index(made, slope.x), _index(made, slope.y)
    by = [(key, _index(made, key)) for key in slope.by]
    for row in made.rows:
        if not (_positive(row[x]) and _positive(row[y])):
            continue
        if isinstance(slope.expected, str):
            theory = row[_index(made, slope.expected)]
        else:
            theory = slope.expected
        group = groups.setdefault(tuple((key, row[at]) for key, at in by), [])
        group.append((math.log(row[x]), math.log(row[y]), theory))  # type: ignore[arg-type]
    rates = []
    for key, points in groups.items():
        if len(points) < max(slope.least, 2):
            continue
        log_x = np.array([p[0] for p in points])
        log_y = np.array([p[1] for p in points])
        if np.ptp(log_x) == 0.0 or log_x[-1] == log_x[-2]:
            continue
        fit = float(np.polyfit(log_x, log_y, 1)[0])
        last = float((log_y[-1] - log_y[-2]) / (log_x[-1] - log_x[-2]))
        rates.append(Rate(key, slope.x, slope.y, len(points), fit, last, points[-1][2]))
    return rates


def _positive(value: Value) -> bool:
    return isinstance(value, int | float) and math.isfinite(value) and value > 0.0


# --- files -----------------------------------------------------------------------------------------------------------


def to_csv(made: Table) -> str:
    """Text of the table in CSV."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([column.name for column in made.columns])
    for row in made.rows:
        writer.writerow([field_text(value) for value in row])
    return out.getvalue()


def field_text(value: Value) -> str:
    """Text of a value in CSV: nine significant digits, nothing for no value."""
    if value is None:
        return ""
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def read_csv(path: str | Path, columns: Sequence[Column], slopes: Sequence[Slope] = ()) -> Table:
    """Read a table written by `to_csv`.

    Raises
    ------
    FormatError : the header names other columns, or a field is not of its column's kind.
    """
    path = Path(path)
    try:
        with path.open(newline="", encoding="utf-8") as file:
            lines = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FormatError(f"{path}: cannot be read: {error}") from None
    names = [column.name for column in columns]
    if not lines or lines[0] != names:
        found = ", ".join(lines[0]) if lines else "nothing"
        raise FormatError(f"{path}: the first line must name the columns {', '.join(names)}; it names {found}")
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        if len(line) != len(columns):
            raise FormatError(f"{path}, line {number}: {len(line)} fields, not {len(columns)}")
        rows.append([_parse(path, number, c, text) for c, text in zip(columns, line, strict=True)])
    return table(path.stem, columns, rows, slopes)


def _parse(path: Path, number: int, column: Column, text: str) -> Value:
    if text == "":
        return None
    try:
        return text if column.kind == "text" else int(text) if column.kind == "int" else float(text)
    except ValueError:
        raise FormatError(f"{path}, line {number}, column {column.name!r}: {text!r} is no number") from None


def to_json(made: Table) -> dict[str, Any]:
    """Return the keys ``columns``, ``rows`` and ``rates`` of the command line's JSON answer."""
    columns = [{"name": c.name, "kind": c.kind, "unit": c.unit} for c in made.columns]
    rows = [dict(zip((c.name for c in made.columns), map(_finite, row), strict=True)) for row in made.rows]
    rates = [
        {
            **dict(rate.group), "x": rate.x, "y": rate.y, "levels": rate.levels, "rate": _finite(rate.fit),
            "last": _finite(rate.last), "expected": rate.expected,
        }
        for rate in made.rates()
    ]  # fmt: skip
    return {"columns": columns, "rows": rows, "rates": rates}


def _finite(value: Value) -> Value:
    """JSON has no infinity and no NaN: they become null."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


# --- terminal --------------------------------------------------------------------------------------------------------


def formatted(column: Column, value: Value) -> str:
    """Text of one value as printed tables show it."""
    if value is None:
        return "–"
    if isinstance(value, str):
        return value
    default = {"int": "d", "float": ".4g", "time": ".2f"}.get(column.kind, "")
    return format(value, column.format or default)


def render(made: Table, title: str | None = None) -> RichTable:
    """Return the table for a rich console (which leaves colours out on pipes and where NO_COLOR is set)."""
    from rich import box
    from rich.table import Table as RichTable

    shown = RichTable(title=title or made.name, box=box.SIMPLE_HEAD, title_justify="left", title_style="bold")
    for column in made.columns:
        heading = f"{column.name}\n[dim]{column.unit}[/dim]" if column.unit else column.name
        shown.add_column(heading, justify="left" if column.kind == "text" else "right", no_wrap=True)
    for row in made.rows:
        shown.add_row(*(formatted(c, value) for c, value in zip(made.columns, row, strict=True)))
    return shown


def render_rates(made: Table) -> RichTable | None:
    """Return the observed rates for a rich console, or None where there are none."""
    from rich import box
    from rich.table import Table as RichTable

    rates = made.rates()
    if not rates:
        return None
    shown = RichTable(title="observed rates", box=box.SIMPLE_HEAD, title_justify="left", title_style="dim")
    shown.add_column("of")
    for heading in ("levels", "fit", "last pair", "theory"):
        shown.add_column(heading, justify="right")
    for rate in rates:
        theory = "–" if rate.expected is None else f"{rate.expected:g}"
        shown.add_row(rate.name, str(rate.levels), f"{rate.fit:.2f}", f"{rate.last:.2f}", theory)
    return shown
