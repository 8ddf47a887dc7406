"""Tables: types, rates, files, and the comparison that continuous integration stands on."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest

from iga.errors import FormatError, InputError
from studies.comparison import compare
from studies.table import Column, Slope, numbers, read_csv, render, render_rates, table, to_csv, to_json

COLUMNS = (
    Column("degree", "int", key=True),
    Column("level", "int", key=True),
    Column("h"),
    Column("l2_error", relative=0.01, format=".2e"),
    Column("defect", at_most=1e-13),
    Column("verdict", "text"),
    Column("seconds", "time", "s"),
)
SLOPES = (Slope("h", "l2_error", ("degree",), expected=3.0),)


def rows(rate=3.0, factor=1.0, defect=3e-15, seconds=0.1):
    return [(2, k, 0.5**k, factor * 0.5 ** (rate * k), defect, "tets", seconds) for k in range(4)]


def make(**changes):
    return table("demo", COLUMNS, rows(**changes), SLOPES)


def test_rates():
    made = make(rate=2.95)
    (rate,) = made.rates()
    assert rate.levels == 4
    assert abs(rate.fit - 2.95) < 1e-12
    assert abs(rate.last - 2.95) < 1e-12
    assert rate.name == "l2_error over h, degree = 2"


def test_two_levels_and_zeros_give_no_rate():
    made = table("demo", COLUMNS, rows()[:2], SLOPES)
    assert made.rates() == ()
    zero = [(*row[:3], 0.0, *row[4:]) for row in rows()]
    assert table("demo", COLUMNS, zero, SLOPES).rates() == ()


def test_csv_and_back(tmp_path):
    path = tmp_path / "demo.csv"
    made = table("demo", COLUMNS, [*rows(), (3, 0, None, None, None, 'a, "b"', None)], SLOPES)
    path.write_text(to_csv(made), encoding="utf-8")
    again = read_csv(path, COLUMNS, SLOPES)
    assert again == made
    assert compare(again, made) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "names nothing"),
        ("degree,level\n", "must name the columns"),
        ("{head}\n1,2\n", "line 2: 2 fields"),
        ("{head}\n1,2,x,1,1,a,1\n", "line 2, column 'h': 'x' is no number"),
        ("{head}\n1.5,2,1,1,1,a,1\n", "line 2, column 'degree'"),
    ],
)
def test_broken_csv_is_told(tmp_path, text, message):
    path = tmp_path / "demo.csv"
    path.write_text(text.format(head=",".join(c.name for c in COLUMNS)))
    with pytest.raises(FormatError, match=message):
        read_csv(path, COLUMNS)


def test_comparison_keeps_tolerances():
    assert compare(make(factor=1.009), make()) == []
    assert compare(make(seconds=99.0), make()) == []  # times are never compared
    found = compare(make(factor=1.02), make())
    assert [d.column for d in found] == ["l2_error"] * 4
    assert str(found[1]) == "degree = 2, level = 1: l2_error: expected 0.125, got 0.1275 (allowed: ± 0.0013)"


def test_comparison_holds_bounds_whatever_the_baseline():
    assert compare(make(defect=9e-14), make(defect=1e-16)) == []
    found = compare(make(defect=2e-13), make(defect=2e-13))
    assert len(found) == 4
    assert "at most 1e-13" in str(found[0])
    assert len(compare(make(defect=float("nan")), make())) == 4


def test_comparison_of_rates_is_apart_from_numbers():
    loose = tuple(Column(c.name, c.kind, c.unit, 10.0, key=c.key) for c in COLUMNS)
    good, bad = (table("demo", loose, rows(rate=r), SLOPES) for r in (3.0, 2.85))
    found = compare(bad, good)
    assert [d.column for d in found] == ["fit", "last pair"]
    assert "expected 3.000, got 2.850" in str(found[0])


def test_comparison_finds_rows_by_key():
    other = table("demo", COLUMNS, [*rows()[::-1][:3], (5, 0, 1.0, 1.0, 0.0, "tets", 1.0)])
    found = compare(other, make())
    assert {(d.row, d.got) for d in found if d.column == "row"} == {
        ("degree = 2, level = 0", "missing"),
        ("degree = 5, level = 0", "present"),
    }
    changed = [(*row[:5], "hexes", row[6]) for row in rows()]
    assert {d.column for d in compare(table("demo", COLUMNS, changed), make())} == {"verdict"}


def test_types_are_checked():
    with pytest.raises(InputError, match="row 0: 2 values for 7 columns"):
        table("t", COLUMNS, [(1, 2)])
    with pytest.raises(InputError, match=r"column 'degree': 1\.5 is no whole number"):
        table("t", COLUMNS, [{"degree": 1.5}])
    with pytest.raises(InputError, match="'x' is no number"):
        table("t", COLUMNS, [{"h": "x"}])
    with pytest.raises(InputError, match="no column 'H'"):
        table("t", COLUMNS, [{"H": 1.0}])
    with pytest.raises(InputError, match="no column 'N'"):
        table("t", COLUMNS, [], [Slope("N", "h")])
    made = table("t", COLUMNS, [{"degree": np.int64(3), "h": np.float64(0.5)}])
    assert made.rows[0][:3] == (3, None, 0.5)


def test_json_is_standard():
    made = table("demo", COLUMNS, [*rows(), (3, 0, float("inf"), float("nan"), 0.0, "x", 0.0)], SLOPES)
    data = json.loads(json.dumps(to_json(made), allow_nan=False))
    assert set(data) == {"columns", "rows", "rates"}
    assert data["rows"][-1]["h"] is None
    assert data["rates"][0]["degree"] == 2
    assert abs(data["rates"][0]["rate"] - 3.0) < 1e-12


def test_rendering_has_no_colour_on_a_pipe():
    from rich.console import Console

    out = io.StringIO()
    console = Console(file=out, width=120)
    console.print(render(make()))
    console.print(render_rates(make()))
    text = out.getvalue()
    assert "\x1b" not in text
    assert "1.25e-01" in text
    assert "l2_error over h, degree = 2" in text


def test_records_and_numbers():
    made = table("demo", COLUMNS, [(3, 0, None, 0.5, 0.0, "tets", None), (3, 1, 0.5, 2, 0.0, "tets", 1.0)])
    first, last = made.records()
    assert (first["degree"], first["h"], last["verdict"]) == (3, None, "tets")
    assert list(first) == [column.name for column in COLUMNS]
    np.testing.assert_array_equal(numbers(made.records(), "h"), [np.nan, 0.5])
    assert numbers(made.records(), "level") == [0.0, 1.0]
    assert numbers([], "level") == []
    with pytest.raises(InputError, match="column 'verdict' has texts"):
        numbers(made.records(), "verdict")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1.5])
def test_counts_are_whole(value):
    with pytest.raises(InputError, match=r"row 0, column 'level': .* is no whole number"):
        table("demo", COLUMNS, [(3, value, None, None, None, None, None)])
