"""Readers and the writer: small files of every format, real files, and damaged ones."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import geometry
from geometry.nurbs import gismo, mfem, write_gismo
from geometry.nurbs.multipatch import glue
from geometry.nurbs.source import build, reads, refine
from geometry.patch import evaluate
from iga.assembly import integral, volume
from iga.domain import check, counts
from iga.errors import FormatError, InputError
from tests.geometry.nurbs_files import FILES, GEOPDES, GISMO, MFEM_PATCHES

EXPECTED = {
    "geopdes.txt": (3.0, 14.0, 18, ["boundary_1", "hot_end"]),
    "gismo.xml": (4.0, 16.0, 18, ["floor"]),
    "patches.mesh": (2.0, 10.0, 12, ["boundary_7", "boundary_8"]),
    "shared.mesh": (2.0, 10.0, 32, ["boundary_7", "boundary_8"]),
}


@pytest.fixture(params=FILES)
def small(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / request.param
    path.write_text(FILES[request.param])
    return path


def test_small_files(small: Path) -> None:
    size, area, functions, names = EXPECTED[small.name]
    domain = build(small)
    check(domain)
    assert reads(small)
    assert volume(domain, 14) == pytest.approx(size, rel=1e-12)
    assert domain.space.n == functions
    assert [n for n in domain.boundaries if not n.startswith("patch")] == names
    assert domain.report["interfaces"] == 1
    assert domain.report["largest_gap"] < 1e-12
    facets = {(f.block, f.face, e) for parts in domain.boundaries.values() for f in parts for e in f.elements.tolist()}
    assert float(integral(domain, points=14, boundary=list(domain.boundaries))) == pytest.approx(area, rel=1e-12)
    assert len(facets) == sum(len(f.elements) for parts in domain.boundaries.values() for f in parts)
    finer = refine(domain, 1, 1)
    check(finer)
    assert volume(finer, 12) == pytest.approx(size, rel=1e-12)
    assert list(finer.boundaries) == list(domain.boundaries)
    assert finer.provenance.parameters["refine"] == finer.provenance.parameters["elevate"] == 1


def test_shared_form_of_mfem_numbers_functions_by_topology(tmp_path: Path) -> None:
    """Every node lies where a linear map of its Greville point puts it, in both patches."""
    path = tmp_path / "shared.mesh"
    path.write_text(FILES["shared.mesh"])
    patches, _ = mfem.read(path)
    u = np.random.default_rng(11).uniform(size=(40, 3))
    # The nodes are Greville points, so each patch is a linear map of its parameters.
    for patch, origin, axes in zip(patches, ([0, 0, 0], [2, 1, 0]), (np.eye(3), np.diag([-1.0, -1, 1]))):
        assert np.abs(evaluate(patch, u) - (np.array(origin) + u @ axes)).max() < 1e-14
    assert patches[1].knots[1].tolist() == [0, 0, 0, 0.75, 1, 1, 1]


def test_gismo_round_trip_is_exact(small: Path, tmp_path: Path) -> None:
    domain = build(small, elevate=1, refine=1)
    out = tmp_path / "out.xml"
    assert write_gismo(out, domain) == out
    again = build(out)
    assert np.array_equal(again.points, domain.points)
    assert all(np.array_equal(a, b) for a, b in zip(
        (x for k, x in sorted(domain.provenance.arrays.items()) if k not in ("names", "named_faces")),
        (x for k, x in sorted(again.provenance.arrays.items()) if k not in ("names", "named_faces")),
    ))
    assert {n for n in again.boundaries if not n.startswith("patch")} == set(EXPECTED[small.name][3])
    second = tmp_path / "second.xml"
    write_gismo(second, again)
    assert second.read_text() == out.read_text()


@pytest.mark.parametrize(
    ("name", "size", "functions", "elements", "interfaces", "turned"),
    [
        ("geopdes_geo_camembert.txt", 2.35619, 28, 3, 0, []),
        ("geopdes_geo_thickL_mp.txt", 3, 16, 3, 2, []),
        ("geopdes_geo_thick_ring.txt", 2.35619, 12, 1, 0, []),
        ("geopdes_geo_twisted_pipe_mp.txt", 2.07566, 160, 24, 2, []),
        ("gismo_GshapedVolume.xml", 0.29772, 81, 7, 0, [0]),
        ("gismo_cylinder.xml", 9.42478, 32, 4, 1, [0]),
        ("gismo_twisted_fichera.xml", 2.15176, 60, 7, 9, []),
        ("mfem_ball-nurbs.mesh", 4.18879, 517, 7, 18, []),
        ("mfem_beam-hex-nurbs.mesh", 8, 36, 8, 1, []),
        ("mfem_pipe-nurbs.mesh", 403.82, 120, 8, 4, []),
        ("mfem_two-cubes-nurbs-rot.mesh", 2, 12, 2, 1, []),
    ],
)
def test_real_files(
    data: Path, name: str, size: float, functions: int, elements: int, interfaces: int, turned: list[int]
) -> None:
    domain = build(data / "nurbs" / name)
    check(domain)
    assert volume(domain, 12) == pytest.approx(size, rel=3e-6)
    assert (domain.space.n, counts(domain)["hexahedron"]) == (functions, elements)
    assert (domain.report["interfaces"], domain.report["turned_round"]) == (interfaces, turned)
    assert domain.report["parts"] == 1


def test_real_gismo_file_comes_back_bit_for_bit(data: Path, tmp_path: Path) -> None:
    for name in ("gismo_twisted_fichera.xml", "gismo_cylinder.xml"):
        patches, _ = gismo.read(data / "nurbs" / name)
        gismo.write(tmp_path / "again.xml", patches)
        again, _ = gismo.read(tmp_path / "again.xml")
        for p, q in zip(patches, again, strict=True):
            assert all(np.array_equal(s, t) for s, t in zip(p.knots, q.knots))
            assert np.array_equal(p.control, q.control)
            assert (p.weights is None) == (q.weights is None)
            assert p.weights is None or np.array_equal(p.weights, q.weights)


def test_interfaces_written_are_those_of_the_file(data: Path, tmp_path: Path) -> None:
    """G+Smo's own list of interfaces, patch by patch and side by side, with the direction maps."""
    path = data / "nurbs" / "gismo_twisted_fichera.xml"

    def listed(text: str) -> set[tuple[tuple[int, ...], ...]]:
        rows = [list(map(int, r.split())) for r in text.split("<interfaces>")[1].split("</")[0].strip().splitlines()]
        return {(min(tuple(r[:2]), tuple(r[2:4])), max(tuple(r[:2]), tuple(r[2:4])), tuple(r[4:])) for r in rows}

    write_gismo(tmp_path / "out.xml", build(path))
    assert listed((tmp_path / "out.xml").read_text()) == listed(path.read_text())


def test_surface_is_refused(data: Path) -> None:
    with pytest.raises(InputError, match="is a surface, not a volume") as caught:
        build(data / "nurbs" / "gismo_teapot.xml")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "old", "new", "said"),
    [
        ("geopdes.txt", "3 3 2 1 1", "2 2 2 1 1", "surface"),
        ("geopdes.txt", "3 3 2 1 1", "3 3 900000 1 1", "900000 patches"),
        ("geopdes.txt", "0 0 0 1 1 1", "0 0 0 1 1 0.5", "patch 1, direction y: knots decrease"),
        ("geopdes.txt", "\n1 1 0.8 0.8", "\n1 -1 0.8 0.8", "patch 1: weight .* must be positive"),
        ("geopdes.txt", "\n1 1 0.8 0.8", "\n1 nan 0.8 0.8", "patch 1: weight"),
        ("geopdes.txt", "2 2\n", "2 9\n", "side 9 of patch 2"),
        ("gismo.xml", "TensorNurbs3", "TensorNurbs2", "patch 0 .id 9.: TensorNurbs2 is a surface"),
        ("gismo.xml", "<xml>", "<!DOCTYPE x [<!ENTITY a 'b'>]><xml>", "DOCTYPE"),
        ("gismo.xml", "0 0 0.5 1 1", "0 0 0.5 1 nan", "not a finite number"),
        ("gismo.xml", "0 0 0.5 1 1", "0 0 0.5 1 1 1", "need 48 numbers, not 36"),
        ("gismo.xml", "2 3 2 3 2 3 2 3", "2 3 2 0 2 3 2 3", "weights must be positive"),
        ("gismo.xml", "id_index\">9 4", "id_index\">9 5", "names patch 5"),
        ("gismo.xml", 'degree="1"', 'degree="99999999"', "do not fit degree 99999999"),
        ("patches.mesh", "dimension\n3", "dimension\n2", "surface"),
        ("patches.mesh", "elements\n2", "elements\n200000000", "200000000"),
        ("patches.mesh", "1 2 0 0 1 1", "1 200000000 0 0 1 1", "200000000"),
        ("patches.mesh", "1 5 5 4", "1 5 5 5", "eight different vertices"),
        ("patches.mesh", "7 3 0 3 9 6", "7 3 0 3 9 5", "boundary element 0"),
        ("shared.mesh", "0 0 1\n1 1 4", "0 0 1\n3 1 4", "edges along y differ"),
        ("shared.mesh", "VDim: 3", "VDim: 2", "VDim 2"),
    ],
)
def test_damage_is_named(tmp_path: Path, name: str, old: str, new: str, said: str) -> None:
    text = FILES[name]
    assert old in text
    path = tmp_path / name
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=said) as caught:
        build(path)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("share", [0.0, 0.1, 0.35, 0.6, 0.8, 0.9])
def test_truncation(tmp_path: Path, name: str, share: float) -> None:
    path = tmp_path / name
    path.write_text(FILES[name][: int(share * len(FILES[name]))])
    with pytest.raises(FormatError):
        build(path)


def test_missing_and_binary_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        build(tmp_path / "none.xml")
    (tmp_path / "x.xml").write_bytes(b"<xml>\xff\xfe\x00<Geometry/>")
    with pytest.raises(FormatError, match="not a text file"):
        build(tmp_path / "x.xml")
    (tmp_path / "deep.xml").write_text("<xml>" + "<Geometry>" * 5000)
    with pytest.raises(FormatError, match="deeper"):
        build(tmp_path / "deep.xml")
    (tmp_path / "other.txt").write_text("hello")
    assert not reads(tmp_path / "other.txt")
    with pytest.raises(FormatError, match="not a NURBS file"):
        build(tmp_path / "other.txt")
    with pytest.raises(InputError):
        geometry.build(tmp_path / "other.txt")
    with pytest.raises(InputError, match="no folder"):
        gismo.write(tmp_path / "nowhere" / "out.xml", [])


PIECES = ["nan", "-1", "0", "1e308", "inf", "99999999", "1.5", "", "<", ">", "&", "\n", "\x00", "é", "patches", "3 3 3"]


@settings(max_examples=150, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(choice=st.data())
def test_mutated_files_raise_input_errors_only(choice: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    name = choice.draw(st.sampled_from(sorted(FILES)))
    raw = FILES[name].encode()
    for _ in range(choice.draw(st.integers(1, 4))):
        at = choice.draw(st.integers(0, len(raw)))
        how = choice.draw(st.sampled_from(["byte", "piece", "cut", "double", "end", "word"]))
        end = min(len(raw), at + choice.draw(st.integers(0, 40)))
        if how == "byte":
            raw = raw[:at] + bytes([choice.draw(st.integers(0, 255))]) + raw[at + 1 :]
        elif how == "piece":
            raw = raw[:at] + choice.draw(st.sampled_from(PIECES)).encode() + raw[end:]
        elif how == "cut":
            raw = raw[:at] + raw[end:]
        elif how == "double":
            raw = raw[:end] + raw[at:end] + raw[end:]
        elif how == "word":
            words = raw.split(b" ")
            words[choice.draw(st.integers(0, len(words) - 1))] = choice.draw(st.sampled_from(PIECES)).encode()
            raw = b" ".join(words)
        else:
            raw = raw[:at]
    path = tmp_path_factory.mktemp("mutated") / name
    path.write_bytes(raw)
    start = time.process_time()
    try:
        check(build(path))
    except InputError as error:
        assert "\n" not in str(error)
    assert time.process_time() - start < 5


def test_examples_really_differ() -> None:
    assert len({GEOPDES, GISMO, MFEM_PATCHES}) == 3
    with pytest.raises(InputError, match="no patch"):
        glue([], where="nothing")
