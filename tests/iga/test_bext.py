"""Bezier extraction files: what is written is read back, and broken files are told in one line."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from iga.bernstein import bernstein
from iga.block import Block, Kronecker
from iga.cells import HEXAHEDRON, TETRAHEDRON
from iga.domain import Domain, Facets, Space
from iga.errors import FormatError, InputError
from iga.exchange.bext import read_bext, write_bext
from iga.sampling import Samples


def spline(rational=True):
    """Two C1 quadratic elements along x, degree (2, 1, 3), with random points, and a block of one element more."""
    first = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.5], [0.0, 0.0, 0.5]]
    last = [[0.5, 0.0, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 1.0]]
    basis = bernstein(HEXAHEDRON, (2, 1, 3))
    number = np.arange(32)[::-1].reshape(4, 2, 4)  # descending, so that the file's ascending order is a real change
    dofs = np.stack([number[:3].ravel(), number[1:].ravel()])
    factors = (np.array([first, last]), np.eye(2)[None], np.eye(4)[None])
    one = Block(basis, dofs, Kronecker(factors, np.array([[0, 0, 0], [1, 0, 0]])))
    two = Block(bernstein(HEXAHEDRON, 1), np.arange(32, 40)[None])
    rng = np.random.default_rng(5)
    weights = rng.uniform(0.5, 2.0, 40) if rational else None
    rest = (Facets(0, 3, np.arange(2)), Facets(1, 5, np.arange(1)))
    boundaries = {"left end": (Facets(0, 0, np.array([0])),), "rest": rest}
    return Domain(Space((one, two), 40, weights), rng.normal(size=(40, 3)), boundaries)


@pytest.mark.parametrize("rational", [False, True])
def test_round_trip(tmp_path, rational):
    domain = spline(rational)
    again = read_bext(write_bext(tmp_path / "a.bext", domain))
    assert (again.space.weights is None) == (not rational)
    xi = np.random.default_rng(3).uniform(size=(7, 3))
    for block, own in enumerate(domain.space.blocks):
        elements = np.arange(own.elements)
        x, y = (Samples(d, block, elements, xi).x for d in (domain, again))
        np.testing.assert_allclose(x, y, atol=1e-15)
    assert set(again.boundaries) == {"left_end", "rest"}
    assert [(f.block, f.face, f.elements.tolist()) for f in again.boundaries["rest"]] == [(0, 3, [0, 1]), (1, 5, [0])]
    # Written again it is the same text: the format has one form.
    second = write_bext(tmp_path / "b.bext", again)
    assert second.read_text() == (tmp_path / "a.bext").read_text()


def test_layout(tmp_path):
    lines = write_bext(tmp_path / "a.bext", spline()).read_text().splitlines()
    assert lines[0] == "B E X T 2.0"
    assert lines[1].split()[:3] == ["1", "40", "3"]
    assert all(len(line.split()) == 4 for line in lines[2:42])
    assert lines[43].split() == ["1", "2", "24", "24", "2", "1", "3"]
    assert lines[44].split() == ["1", "1", "8", "8", "1", "1", "1"]
    nodes = [int(word) for line in lines[45:48] for word in line.split()]
    assert len(nodes) == 24
    assert nodes == sorted(nodes)
    assert max(len(line.split()) for line in lines[1:] if not line.startswith("$")) == 10


def test_without_names_the_outside_is_the_boundary(tmp_path):
    path = write_bext(tmp_path / "a.bext", spline())
    path.write_text("".join(x for x in path.read_text().splitlines(True) if not x.startswith("$#")))
    domain = read_bext(path)
    (facets,) = domain.boundaries.values()
    # Five faces of each of the two joined elements, six of the lone one.
    assert sum(len(f.elements) for f in facets) == 16


def test_what_cannot_be_written_is_told(tmp_path):
    basis = bernstein(TETRAHEDRON, 1)
    domain = Domain(Space((Block(basis, np.arange(4)[None]),), 4), TETRAHEDRON.vertices)
    with pytest.raises(InputError, match="block 0 holds tetrahedrons"):
        write_bext(tmp_path / "a.bext", domain)
    assert not list(tmp_path.iterdir())


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_mutated_files_give_one_line(tmp_path, data):
    path = tmp_path / "a.bext"
    if not path.exists():
        write_bext(path, spline())
    words = path.read_text().split(" ")
    action = data.draw(st.sampled_from(["cut", "replace", "drop"]))
    at = data.draw(st.integers(1, len(words) - 1))
    if action == "cut":
        words = words[:at]
    elif action == "drop":
        del words[at]
    else:
        words[at] = data.draw(st.sampled_from(["nan", "-1", "x", "999999999", "0", "1e300", "$#"]))
    broken = tmp_path / "broken.bext"
    broken.write_text(" ".join(words))
    try:
        read_bext(broken)
    except FormatError as error:
        assert "broken.bext" in str(error)
        assert "\n" not in str(error)
