"""Rules for parameters of sources, and the tables of rules that the sources keep."""

from __future__ import annotations

import inspect
import math
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from geometry.catmull_clark import settings as catmull_clark
from geometry.hybrid import settings as hybrid
from geometry.meccano import settings as meccano
from geometry.nurbs import source as nurbs
from geometry.nurbs.shapes import SHAPES
from geometry.parameters import LARGEST, Rule, optional, parsed, real, rows, truth, whole, word
from geometry.tets import source as tets
from iga.errors import InputError

TAKEN: list[tuple[Rule, object, object]] = [
    (real(), " 1e3 ", 1000.0), (real(0.0, 1.0), 0, 0.0), (real(0.0, 1.0), "1", 1.0),
    (real(0.0, ends=False), 1e-300, 1e-300),
    (whole(), "0", 0), (whole(), 7.0, 7), (whole(), np.int64(3), 3), (whole(-2, 2), "-2", -2),
    (truth(), "Yes", True), (truth(), True, True), (truth(), 0, False), (truth(), "no", False),
    (word("pia", "none"), "PIA ", "pia"), (word("pia", "none"), None, "none"),
    (rows(3, real()), "1,2,3; 4,5,6", ((1.0, 2.0, 3.0), (4.0, 5.0, 6.0))),
    (rows(2, whole()), np.array([[1.0, 2.0]]), ((1, 2),)),
    (optional(whole()), "auto", None), (optional(whole()), None, None), (optional(whole()), "4", 4),
    (optional(real(), "never"), "never", None),
]  # fmt: skip

REFUSED: list[tuple[Rule, object, str]] = [
    (real(), "abc", "a number, not 'abc'"), (real(), math.nan, "a number, not nan"),
    (real(), "inf", "a number, not 'inf'"),
    (real(), None, "a number, not None"), (real(), [1.0], r"a number, not \[1.0\]"),
    (real(0.0, 1.0), 1.5, "a number from 0 to 1, not 1.5"),
    (real(0.0, 1.0, ends=False), 1, "above 0 and below 1, not 1"),
    (real(1.0, ends=False), "1", "a number above 1, not '1'"), (real(high=2.0), 3, "a number to 2, not 3"),
    (whole(), 2.5, "a whole number from 0 on, not 2.5"), (whole(), -1, "from 0 on, not -1"),
    (whole(), "1e300", "from 0 on, not '1e300'"), (whole(), math.nan, "not nan"), (whole(), math.inf, "not inf"),
    (whole(3, 8), "9", "a whole number from 3 to 8, not '9'"), (whole(), 10 * LARGEST, "from 0 on"),
    (whole(), "9" * 400, f"not '{'9' * 79}[.][.]$"),
    (truth(), "maybe", "true or false, not 'maybe'"), (truth(), 2, "true or false, not 2"),
    (word("pia", "none"), "pi", "one of pia, none, not 'pi'"),
    (rows(3, real()), "1,2; 3,4", "rows of 3 entries as x,y,z; x,y,z; .., each a number, not '1,2; 3,4'"),
    (rows(3, real()), "1,2,nan", "rows of 3 entries"), (rows(3, real()), (), r"rows of 3 entries .*, not \(\)"),
    (rows(3, real()), 5, "rows of 3 entries"), (rows(2, whole()), "1,2.5", "each a whole number from 0 on"),
    (rows(3, real()), np.ones((2, 2)), r"not array\(\[\[1., 1.\], \[1., 1.\]\]\)$"),
    (optional(whole(1)), 0, "auto or a whole number from 1 on, not 0"),
]  # fmt: skip


@pytest.mark.parametrize(("rule", "given", "value"), TAKEN)
def test_what_fits_is_read(rule: Rule, given: object, value: object) -> None:
    found = parsed("source", {"key": given}, {"key": rule})["key"]
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(("rule", "given", "said"), REFUSED)
def test_what_does_not_fit_is_refused_in_one_line(rule: Rule, given: object, said: str) -> None:
    with pytest.raises(InputError, match=f"^key must be .*{said}") as caught:
        parsed("source", {"key": given}, {"key": rule})
    assert "\n" not in str(caught.value)


def test_unknown_names_are_refused_with_those_there_are() -> None:
    with pytest.raises(InputError, match=r"the source tets has no parameter 'b'; there are: a, c$"):
        parsed("tets", {"c": 1, "d": 1, "b": 1}, {"a": whole(), "c": whole()})


@pytest.mark.parametrize("module", [catmull_clark, hybrid, meccano])
def test_every_setting_has_a_rule_that_takes_its_default(module: object) -> None:
    settings = module.Settings()
    names = {"lam": "lambda"}
    assert [names.get(f.name, f.name) for f in fields(settings)] == list(module.RULES)
    given = {names.get(key, key): value for key, value in vars(settings).items()}
    assert module.parse(given) == settings
    assert module.parse({}) == settings
    # As a command line gives them: texts.
    assert module.parse({key: str(value) for key, value in given.items() if value is not None}) == settings


def test_rules_of_tets_and_nurbs_take_the_defaults() -> None:
    assert parsed("tets", tets.DEFAULTS, tets.RULES | tets.OF_SHAPES) == tets.DEFAULTS
    for name, maker in SHAPES.items():
        known = {**nurbs.COMMON, **{key: p.default for key, p in inspect.signature(maker).parameters.items()}}
        assert nurbs.check_parameters(known, known, name) == known


def test_labels_come_from_a_file_or_a_sequence(tmp_path: Path) -> None:
    path = tmp_path / "labels.txt"
    path.write_text("0 1 5\n2\n")
    assert meccano.parse({"labels": str(path)}).labels == (0, 1, 5, 2)
    assert meccano.parse({"labels": np.array([3, 0])}).labels == (3, 0)
    for text in ("0 1.5", "0 one", "0 -1", "0 nan"):
        path.write_text(text)
        with pytest.raises(InputError, match="labels must be auto or a file with the side of each triangle"):
            meccano.parse({"labels": path})


def test_files_of_features_say_which_line_is_wrong(tmp_path: Path) -> None:
    path = tmp_path / "features.txt"
    path.write_text("0 1 # an edge\n\n7\n")
    edges, corners = catmull_clark.parse({"features": str(path)}).features
    assert (edges.tolist(), corners.tolist()) == ([[0, 1]], [7])
    path.write_text("0 1\n1 2 3\n")
    with pytest.raises(InputError, match=r"features.txt, line 2: '1 2 3' is neither"):
        catmull_clark.parse({"features": str(path)})
    for bad in ("nan", "-5", 181.0, str(tmp_path), "no such file"):
        with pytest.raises(InputError, match="features must be auto, none, an angle from 0 to 180 degrees, or a file"):
            catmull_clark.parse({"features": bad})


def test_shape_parameters_are_numbers_names_or_arrays() -> None:
    assert catmull_clark.parse({"lambda": "0.5"}).lam == catmull_clark.parse({"lam": 0.5}).lam == 0.5
    assert catmull_clark.parse({"mu": "tension"}).mu == "tension"
    assert np.array_equal(catmull_clark.parse({"mu": np.array([1, 2])}).mu, [1.0, 2.0])
    for bad in (0, "1", "nan", math.inf, None):
        with pytest.raises(InputError, match="mu must be a number above 0 and below 1, the name"):
            catmull_clark.parse({"mu": bad})
