"""The list of sources: guessing, refining through it, other packages' sources."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import SimpleNamespace

import meshio
import numpy as np
import pytest

import geometry
from iga.domain import Domain, Provenance, check
from iga.errors import InputError
from iga.store import load, save
from tests.geometry.nurbs_files import FILES


def test_built_in_sources_come_first() -> None:
    known = geometry.sources()
    assert list(known)[:2] == ["nurbs", "tets"]
    for name, source in known.items():
        assert source.name == name
        assert not source.reads("no such file")


def test_shapes_and_meshes_are_built_without_naming_a_source(tmp_path: Path) -> None:
    """The first source that has the shape, or reads the cells of a file whose ending several know."""
    def found(given: str | Path) -> str:
        return next(name for name, source in geometry.sources().items() if source.reads(given))

    shapes = {"ball": "nurbs", "fan_5": "catmull_clark", "star": "meccano", "bracket": "hybrid"}
    assert {shape: found(shape) for shape in shapes} == shapes
    points = np.array([*np.ndindex(2, 2, 2)], dtype=float)
    for kind, cell, source in (
        ("hexahedron", [0, 4, 6, 2, 1, 5, 7, 3], "catmull_clark"), ("tetra", [0, 4, 2, 1], "tets"),
    ):  # fmt: skip
        meshio.write_points_cells(tmp_path / f"{kind}.vtk", points, [(kind, np.array([cell]))])
        assert found(tmp_path / f"{kind}.vtk") == source
    (tmp_path / "cut_off.vtk").write_text("# vtk DataFile")
    with pytest.raises(InputError, match=r"cut_off\.vtk: cannot be read as a mesh"):
        geometry.build(tmp_path / "cut_off.vtk")


@pytest.mark.parametrize("name", ["nurbs", "tets", "catmull_clark", "meccano", "hybrid"])
def test_shapes_are_named_where_the_command_line_explains_a_source(name: str) -> None:
    """`iga sources NAME` prints the module's docstring."""
    module = importlib.import_module(f"geometry.{name}.source")
    assert all(shape in (module.__doc__ or "") for shape in module.SHAPES)
    with pytest.raises(InputError, match=next(iter(module.SHAPES))):
        module.build("no such shape")


def test_source_is_guessed_from_the_content(tmp_path: Path) -> None:
    for name, text in FILES.items():
        path = tmp_path / f"model{Path(name).suffix}"
        path.write_text(text)
        domain = geometry.build(path)
        assert domain.provenance.source == "nurbs"
        assert domain.provenance.input == str(path)
    assert geometry.build("thick_ring", angle=90).provenance.source == "nurbs"


def test_a_saved_domain_refines_like_the_one_in_memory(tmp_path: Path) -> None:
    domain = geometry.build("cylinder", refine=1)
    save(domain, tmp_path / "domain.npz")
    one, two = geometry.refine(domain, 1, 1), geometry.refine(load(tmp_path / "domain.npz"), 1, 1)
    check(two)
    assert np.array_equal(one.points, two.points)
    assert {k: [f.elements.tolist() for f in v] for k, v in one.boundaries.items()} == {
        k: [f.elements.tolist() for f in v] for k, v in two.boundaries.items()
    }
    direct = geometry.build("cylinder", refine=2, elevate=1)
    assert two.space.n != direct.space.n  # refining first leaves the first knots less smooth
    assert two.provenance.parameters["refine"] == 2


def test_errors_name_the_sources(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no geometry source is called 'step'; there are: nurbs, tets"):
        geometry.build("cube", "step")
    with pytest.raises(InputError, match="no such file"):
        geometry.build(tmp_path / "absent.xml")
    (tmp_path / "text.txt").write_text("nothing")
    with pytest.raises(InputError, match="no geometry source reads it"):
        geometry.build(tmp_path / "text.txt")
    cube = geometry.build("cube")
    alien = Domain(cube.space, cube.points, provenance=Provenance("voxels"))
    with pytest.raises(InputError, match="source 'voxels', which is not here"):
        geometry.refine(alien)
    with pytest.raises(InputError, match="by source 'voxels', not by 'nurbs'"):
        geometry.sources()["nurbs"].refine(alien)


def test_sources_of_other_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    other = SimpleNamespace(
        name="other", reads=lambda path: str(path) == "anything", build=lambda path: geometry.build("cube"),
        refine=lambda domain, levels=1, elevate=0: domain,
    )

    def points(target: object) -> list[SimpleNamespace]:
        def loaded() -> object:
            if target is None:
                raise ImportError("broken")
            return target

        return [SimpleNamespace(name="other", value="some-package", load=loaded)]

    monkeypatch.setitem(geometry.sources.__globals__, "entry_points", lambda group: points(other))
    assert list(geometry.sources())[-1] == "other"
    assert geometry.build("anything").space.n == 8
    monkeypatch.setitem(geometry.sources.__globals__, "entry_points", lambda group: points(None))
    with pytest.raises(InputError, match="'other' of some-package cannot be loaded: broken"):
        geometry.sources()
    monkeypatch.setitem(geometry.sources.__globals__, "entry_points", lambda group: points(SimpleNamespace(name="x")))
    with pytest.raises(InputError, match="has no 'reads'"):
        geometry.sources()
