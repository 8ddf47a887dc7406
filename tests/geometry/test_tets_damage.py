"""Damaged files of tet meshes: read as something sound, or refused in one line, in little memory."""

from __future__ import annotations

import sys

import meshio
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from geometry.tets.reader import read_tets
from geometry.tets.shapes import ball
from geometry.tets.source import build
from iga.errors import FormatError, InputError
from tests.geometry.tets_files import nodes_of, write


@pytest.mark.parametrize("file", ["sphere_P2.msh", "sphere_P4.msh", "escher_P2.vtk", "torus.msh", "bunny.mesh"])
@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.6, 0.9])
def test_truncated_files(file, share, tmp_path, data, capsys):
    source = data / "tet" / file
    (tmp_path / file).write_bytes(source.read_bytes()[: int(share * source.stat().st_size)])
    with pytest.raises(InputError) as raised:
        read_tets(tmp_path / file)
    assert str(raised.value).startswith(str(tmp_path / file))
    assert "\n" not in str(raised.value)
    assert capsys.readouterr() == ("", "")


@pytest.fixture(scope="module")
def small_files(tmp_path_factory) -> list[tuple[str, bytes]]:
    folder = tmp_path_factory.mktemp("small")
    mesh = ball(0, 1)
    made = [write(folder / f"ball1{ending}", mesh) for ending in (".mesh", ".vtu", ".vtk", ".inp", ".msh")]
    made += [write(folder / "ball2.msh", ball(0, 2)), write(folder / "ball3.msh", ball(0, 3), "gmsh")]
    points, cells = nodes_of(mesh, "vtk")
    meshio.write(folder / "ascii.msh", meshio.Mesh(points, [("tetra", cells)]), file_format="gmsh", binary=False)
    meshio.write(folder / "old.msh", meshio.Mesh(points, [("tetra", cells)]), file_format="gmsh22", binary=False)
    return [(path.suffix, path.read_bytes()) for path in [*made, folder / "ascii.msh", folder / "old.msh"]]


@pytest.mark.skipif(sys.platform != "linux", reason="memory is bounded on Linux only")
def test_a_label_that_asks_for_all_memory_is_refused(tmp_path):
    points, cells = nodes_of(ball(0, 1), "vtk")
    path = tmp_path / "label.msh"
    meshio.write(path, meshio.Mesh(points, [("tetra", cells)]), file_format="gmsh22", binary=False)
    text = path.read_text()
    assert build(path).space.n == len(points)
    path.write_text(text.replace(f"\n{len(points)} ", "\n2000000000 "))
    with pytest.raises(FormatError, match="MemoryError"):
        build(path)
    np.ones(10**7)  # and there is memory again


@settings(max_examples=400, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.integers(0, 8),
    st.lists(
        st.tuples(st.floats(0, 1), st.sampled_from(["flip", "cut", "double", "digit", "zero"]), st.integers(1, 255)),
        min_size=1,
        max_size=4,
    ),
)
def test_mutated_files_are_read_or_refused(small_files, tmp_path, which, changes):
    ending, content = small_files[which]
    data = bytearray(content)
    for place, kind, value in changes:
        at = min(int(place * len(data)), len(data) - 1)
        if at < 0:
            break
        if kind == "flip":
            data[at] ^= value
        elif kind == "cut":
            del data[at : at + value]
        elif kind == "double":
            data[at:at] = data[at : at + value]
        elif kind == "digit":
            data[at] = ord("0") + value % 10
        else:
            data[at] = 0
    path = tmp_path / f"mutated{ending}"
    path.write_bytes(bytes(data))
    try:
        domain = build(path)
    except InputError as error:
        assert "\n" not in str(error)
    else:
        assert np.isfinite(domain.points).all()
