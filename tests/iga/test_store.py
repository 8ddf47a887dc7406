"""Domain files: round trip of every kind of block, hostile bytes, nothing half-written."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array, eye_array

from iga.bernstein import bernstein
from iga.block import Block, Kronecker, Patterns
from iga.cells import HEXAHEDRON
from iga.conforming import straight_domain
from iga.domain import Domain, Provenance, Space
from iga.errors import FormatError, InputError
from iga.store import load, save
from tests.meshes import mixed_complex


def everything() -> Domain:
    """A domain that uses every field of the layout."""
    mesh, points = mixed_complex()
    base = straight_domain(mesh, points, 2)
    n = base.space.n
    dofs = base.space.blocks[0].dofs
    one = np.eye(3)[None]
    zero = np.zeros((1, 3), dtype=np.int64)
    blocks = (
        *base.space.blocks,
        Block(bernstein(HEXAHEDRON, 2), dofs, Kronecker((one, one, one), zero), np.array([4])),
        Block(bernstein(HEXAHEDRON, 2), dofs, Patterns(np.eye(27)[None], np.array([0]))),
    )
    space = Space(blocks, n, np.linspace(1, 2, n), csr_array(eye_array(n)))
    origin = Provenance("tets", "a.msh", {"degree": 2, "convert": "hex4"}, {"tets": np.arange(8).reshape(2, 4)})
    report = {"parts": 1, "x": np.float64(0.5)}
    return Domain(space, base.points, base.boundaries, {"k": np.ones((n, 2))}, origin, report)


def test_round_trip(tmp_path: Path) -> None:
    domain = everything()
    save(domain, tmp_path / "d.npz")
    again = load(tmp_path / "d.npz")
    assert again.space.n == domain.space.n
    assert np.array_equal(again.points, domain.points)
    assert np.array_equal(again.space.weights, domain.space.weights)
    assert (again.space.constraint != domain.space.constraint).nnz == 0
    for a, b in zip(again.space.blocks, domain.space.blocks):
        assert a.basis == b.basis
        assert np.array_equal(a.dofs, b.dofs)
        assert type(a.extraction) is type(b.extraction)
    assert again.space.blocks[4].parent.tolist() == [4]
    assert list(again.boundaries) == ["boundary"]
    assert again.attributes["k"].shape == (domain.space.n, 2)
    assert again.provenance.parameters == {"degree": 2, "convert": "hex4"}
    assert again.provenance.arrays["tets"].tolist() == [[0, 1, 2, 3], [4, 5, 6, 7]]
    assert again.report == {"parts": 1, "x": 0.5}


def test_interrupted_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "d.npz"
    path.write_bytes(b"old")

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np.lib.format, "write_array", full)
    with pytest.raises(InputError, match="No space left on device"):
        save(everything(), path)
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["d.npz"]


def test_missing_folder_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no folder"):
        save(everything(), tmp_path / "nowhere" / "d.npz")
    with pytest.raises(FormatError, match="does not exist"):
        load(tmp_path / "d.npz")
    (tmp_path / "mesh.vtk").write_text("# vtk DataFile Version 3.0")
    with pytest.raises(FormatError, match="is not a saved domain; `iga build` makes one"):
        load(tmp_path / "mesh.vtk")


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("store") / "d.npz"
    save(everything(), path)
    return path.read_bytes()


def test_open_header_of_an_array_is_one_line(image: bytes, tmp_path: Path) -> None:
    # The header of an array is Python text, which NumPy gives to a tokenizer.
    path = tmp_path / "d.npz"
    with zipfile.ZipFile(io.BytesIO(image)) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name).replace(b"}", b"(", 1) if name == "points.npy" else old.read(name))
    with pytest.raises(FormatError, match="is damaged"):
        load(path)


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_mutated_files_raise_one_kind_of_error(image: bytes, tmp_path_factory: pytest.TempPathFactory,
                                               data: st.DataObject) -> None:
    position = data.draw(st.integers(0, len(image) - 1))
    junk = data.draw(st.binary(max_size=6))
    cut = data.draw(st.booleans())
    mutated = image[:position] + junk + (b"" if cut else image[position + len(junk):])
    path = tmp_path_factory.getbasetemp() / "mutated.npz"
    path.write_bytes(mutated)
    try:
        load(path)
    except InputError as error:
        assert "\n" not in str(error)
