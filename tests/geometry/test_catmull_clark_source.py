"""The source: building, settings, refinement, validity, saving."""

from __future__ import annotations

from dataclasses import replace

import meshio
import numpy as np
import pytest

import geometry.catmull_clark as source
from geometry.catmull_clark.mesh import hex_mesh
from geometry.catmull_clark.settings import Settings, parse
from geometry.catmull_clark.shapes import ball, box, fan
from iga.assembly import integral, volume
from iga.cells import HEXAHEDRON
from iga.certificate import quality
from iga.chunk import facet_chunks
from iga.domain import check
from iga.errors import InputError
from iga.field import Field
from iga.store import load, save
from problems import Elasticity, elasticity
from problems import parse as parse_formula
from problems.material import isotropic


def _write(path, points: np.ndarray, cells: np.ndarray, **data: np.ndarray):
    meshio.write(path, meshio.Mesh(points, [("hexahedron", cells[:, list(HEXAHEDRON.vtk)])], point_data=data))
    return path


@pytest.mark.parametrize("interpolate", ["auto", "pia", "conjugate", "direct", "pushback", "none"])
def test_methods_build_refine_and_save(tmp_path, interpolate: str) -> None:
    points, cells = fan(5)
    given = np.random.default_rng(3).random(len(points))
    path = _write(tmp_path / "fan.vtk", points, cells, stiffness=given, triple=np.column_stack([given, -given, given]))
    assert source.reads(path)
    domain = source.build(path, interpolate=interpolate, features="auto", depth="1")
    check(domain)
    assert (domain.report["interpolation_error"] < 1e-13) == (interpolate != "none")
    assert domain.attributes["triple"].shape == (domain.space.n, 3)
    np.testing.assert_allclose(domain.attributes["triple"][:, 1], -domain.attributes["stiffness"], atol=1e-12)
    assert quality(domain)["refuted"] == 0
    save(domain, tmp_path / "domain.npz")
    again = load(tmp_path / "domain.npz")
    finer = source.refine(again)
    check(finer)
    assert finer.report["levels"] == 1
    assert sorted(finer.boundaries) == sorted(domain.boundaries)
    assert finer.provenance.arrays["hexes"].shape[0] == 8 * domain.provenance.arrays["hexes"].shape[0]
    assert abs(volume(finer) / volume(domain) - 1) < 1e-3


def test_regular_volume_does_not_change_by_refinement() -> None:
    points, cells = box(3, 3, 3)
    points = points + 0.05 * np.sin(points[:, [1, 2, 0]] * 2.0)
    domain = source.domain_of(hex_mesh(points, cells))
    assert abs(volume(source.refine(domain, 2), 5) / volume(domain, 5) - 1) < 1e-13


def test_singular_boundary_is_solved_by_push_back() -> None:
    points, cells = ball()
    points[8] += 0.1
    domain = source.domain_of(hex_mesh(points, cells), Settings(features="none", interpolate="pia"))
    assert domain.report["singular_boundary"] == 8 or domain.report["interpolation_error"] < 1e-13
    assert domain.report["interpolation_error"] < 1e-13
    assert domain.report["cells"] == 56


def test_smooth_folds_are_told() -> None:
    points, cells = box(3, 3, 3)
    domain = source.domain_of(hex_mesh(points, cells), Settings(features="none", interpolate="none"))
    assert domain.report["folded_cells"] == 20
    assert "features" in domain.report["folded_cells_cure"]
    found = quality(domain)
    assert found["degenerate"] >= 20


@pytest.mark.parametrize("made", [box(3, 3, 3), fan(5)])
def test_pillowing_cures_smooth_folds(made: tuple[np.ndarray, np.ndarray]) -> None:
    points, cells = made
    mesh = hex_mesh(points, cells, {"x": points[:, 0]})
    domain = source.domain_of(mesh, Settings(features="none", interpolate="none", pillow=True))
    check(domain)
    faces = sum(len(f.elements) for f in source.domain_of(mesh, Settings(depth=0)).boundaries.values() for f in f)
    assert domain.report["folded_cells"] == 0
    assert domain.report["cells"] == len(cells) + faces
    found = quality(domain)
    assert found["certified"] == sum(block.elements for block in domain.space.blocks)
    np.testing.assert_allclose(domain.attributes["x"], domain.points[:, 0], atol=1e-12)


def test_settings_are_checked() -> None:
    for parameters, match in (
        ({"lambda": 1.5}, "lambda must be a number above 0 and below 1"), ({"depth": 9}, "depth"),
        ({"colour": 1}, "no parameter 'colour'"), ({"interpolate": "best"}, "interpolate"),
        ({"repair": "maybe"}, "repair"), ({"features": "sharp"}, "features"), ({"space": "other"}, "space"),
    ):
        with pytest.raises(InputError, match=match) as caught:
            parse(parameters)
        assert "\n" not in str(caught.value)
    made = parse({"repair": "true", "depth": "auto", "features": "30", "attributes": "a, b"})
    assert (made.repair, made.depth, made.features, made.attributes) == (True, None, 30.0, ("a", "b"))
    mesh = hex_mesh(*ball())
    with pytest.raises(InputError, match="no attribute 'a'"):
        source.domain_of(mesh, made)
    with pytest.raises(InputError, match="elevated"):
        source.refine(source.domain_of(mesh), elevate=1)


def test_folds_of_interpolation_are_undone_but_those_of_the_input_are_told() -> None:
    points, cells = box(4, 4, 4)
    inside = int(np.flatnonzero((points == 2).all(axis=1))[0])
    points[inside] += [0.8, 0.7, 0.6]
    strict = source.domain_of(hex_mesh(points, cells), Settings(interpolate="pia"))
    assert quality(strict)["refuted"] > 0
    assert strict.report["interpolation_error"] < 1e-13
    relaxed = source.domain_of(hex_mesh(points, cells))
    assert quality(relaxed)["certified"] == 64
    assert relaxed.report["moved_vertices"] > 0
    assert relaxed.report["interpolation_error_boundary"] < 1e-13
    points[inside] = [5.5, 5.5, 5.5]
    inverted = hex_mesh(points, cells)
    assert quality(source.domain_of(inverted, Settings(interpolate="none")))["refuted"] > 0
    assert quality(source.domain_of(inverted))["refuted"] > 0
    assert quality(source.domain_of(inverted, Settings(repair=True)))["certified"] == 64


def test_rod_and_ellipsoid(data) -> None:
    for file, cells in (("rod.vtk", 1280), ("ellipsoid.mesh", 6816)):
        domain = source.build(data / "hex" / file, depth=0)
        found = quality(domain)
        assert (found["certified"], found["refuted"], found["undecided"]) == (cells, 0, 0)
        assert domain.report["interpolation_error_boundary"] < 1e-13
    inverted = source.build(data / "hex" / "rod_pillowed_inverted.vtk", interpolate="none", depth=0)
    assert quality(inverted)["refuted"] > 0


def test_parameters_of_push_back_may_vary(tmp_path) -> None:
    """Numbers, one number for each entity, or an attribute; equal ones give equal control points."""
    points, cells = fan(5)
    mesh = hex_mesh(points, cells, {"tension": np.full(len(points), 0.3), "graded": 0.1 + 0.1 * points[:, 2]})
    t = mesh.topology
    made = {
        "number": Settings(interpolate="pushback", lam=0.3),
        "name": parse({"interpolate": "pushback", "lambda": "tension"}),
        "array": Settings(interpolate="pushback", lam=np.full(len(t.edges), 0.3)),
    }
    built = {key: source.domain_of(mesh, settings) for key, settings in made.items()}
    for key in ("name", "array"):
        np.testing.assert_allclose(built[key].points, built["number"].points, atol=1e-14)
    graded = source.domain_of(mesh, parse({"interpolate": "pushback", "gamma": "graded", "mu": "graded"}))
    assert graded.report["interpolation_error"] < 1e-13
    assert np.abs(graded.points - built["number"].points).max() > 1e-3
    save(graded, tmp_path / "graded.npz")
    for parameters, match in (
        ({"lambda": "none"}, "lambda must be a number or the name of an attribute, not 'none'"),
        ({"mu": np.full(3, 0.5)}, "mu needs one number, or one for each face"),
        ({"gamma": np.full(len(cells), 1.0)}, "gamma of cell 0 is 1"),
    ):
        with pytest.raises(InputError, match=match) as caught:
            source.domain_of(mesh, parse({"interpolate": "pushback", **parameters}))
        assert "\n" not in str(caught.value)


def test_features_by_a_given_set(tmp_path) -> None:
    points, cells = box(2, 2, 2)
    path = _write(tmp_path / "box.vtk", points, cells)
    (tmp_path / "creases.txt").write_text("0 1   # along z\n1 2\n\n0\n2\n")
    domain = source.build(path, features=str(tmp_path / "creases.txt"))
    assert (domain.report["crease_edges"], domain.report["corners"]) == (2, 2)
    creases, corners = np.array([[0, 1], [1, 2]]), np.array([0, 2])
    direct = source.domain_of(hex_mesh(points, cells), Settings(features=(creases, corners)))
    np.testing.assert_array_equal(direct.points, domain.points)
    save(direct, tmp_path / "direct.npz")
    (tmp_path / "creases.txt").write_text("0 13\n")
    with pytest.raises(InputError, match="no boundary edge between vertices 0 and 13"):
        source.build(path, features=str(tmp_path / "creases.txt"))
    (tmp_path / "creases.txt").write_text("0 1 2\n")
    with pytest.raises(InputError, match=r"creases\.txt, line 1"):
        source.build(path, features=str(tmp_path / "creases.txt"))


def test_graded_material_through_the_command_line(tmp_path, capsys) -> None:
    """Attribute of a file -> domain -> conductivity and Young's modulus of a case, exact at the vertices."""
    from geometry.catmull_clark.lattice import limit_matrix
    from studies.cli import main

    points, cells = box(3, 3, 3)
    value = 1.0 + points[:, 0]
    path = _write(tmp_path / "box.vtk", points, cells, k=value)
    domain_file, case = tmp_path / "box.npz", tmp_path / "case.toml"
    _run(main, ["build", str(path), "--source", "catmull_clark", "-o", str(domain_file), "--json"], capsys)
    domain = load(domain_file)
    given = hex_mesh(points, cells)
    limit = limit_matrix(source.source.stored_topology(domain)) @ domain.attributes["k"]
    order = np.lexsort(given.points.T)
    np.testing.assert_allclose(limit[order], value[np.lexsort(points.T)], atol=1e-12)
    # -(k u')' = 0 with k = 1 + x, u = log(1 + x): found far better than with a constant k.
    build = ["build", str(path), "--source", "catmull_clark", "--set", "space=optimal"]
    _run(main, [*build, "-o", str(domain_file), "--json"], capsys)
    heat = 'problem = "heat"\nexact = "log(1+x)"\n[material]\nconductivity = { attribute = "k" }\n'
    case.write_text(heat + '[boundary."*"]\ntemperature = "log(1+x)"\n')
    found = _run(main, ["solve", str(domain_file), str(case), "-o", str(tmp_path / "u.vtu"), "--json"], capsys)
    assert found["relative_l2_error"] < 1e-3
    case.write_text(heat.replace('{ attribute = "k" }', "1") + '[boundary."*"]\ntemperature = "log(1+x)"\n')
    assert _run(main, ["solve", str(domain_file), str(case), "-o", str(tmp_path / "u.vtu"), "--json"], capsys)[
        "relative_l2_error"
    ] > 5 * found["relative_l2_error"]
    # Uniaxial stress needs E u' constant: u = log(1 + x), E = 1 + x, nu = 0.
    case.write_text(
        'problem = "elasticity"\nexact = "log(1+x); 0; 0"\n[material]\nE = { attribute = "k" }\nnu = 0\n'
        '[boundary."*"]\ndisplacement = ["log(1+x)", 0, 0]\n'
    )
    found = _run(main, ["solve", str(domain_file), str(case), "-o", str(tmp_path / "u.vtu"), "--json"], capsys)
    assert found["relative_l2_error"] < 1e-3
    modes = 'problem = "heat"\n[material]\nconductivity = 1\ncapacity = { attribute = "k" }\n'
    case.write_text(modes + '[boundary."*"]\ntemperature = 0\n[modes]\ncount = 1\n')
    graded = _run(main, ["solve", str(domain_file), str(case), "-o", str(tmp_path / "u.vtu"), "--json"], capsys)
    # The mean density is 2.5; by symmetry of the lowest mode the eigenvalue is close to that of a constant one.
    assert abs(graded["eigenvalues"][0] / (3 * (np.pi / 3) ** 2 / 2.5) - 1) < 0.05


def test_graded_density_of_an_elastic_bar() -> None:
    """Attribute as density: waves along a bar of density 1 + x between fixed ends are Airy functions."""
    from scipy.optimize import brentq
    from scipy.special import airy

    points, cells = box(6, 2, 2)
    mesh = hex_mesh(points, cells, {"density": 1.0 + points[:, 0]})
    domain = source.domain_of(mesh, Settings(space="optimal"))
    density = Field(domain.space, np.asarray(domain.attributes["density"]))
    ends = {
        name: float(np.ptp(np.concatenate([chunk.x[..., 0].ravel() for chunk in facet_chunks(domain, facets)]))) < 1e-9
        for name, facets in domain.boundaries.items()
    }
    assert sum(ends.values()) == 2
    held = {name: (0.0 if end else None, 0.0, 0.0) for name, end in ends.items()}
    problem = Elasticity(isotropic(1.0, 0.0), displacement=held, density=density)
    found = elasticity.modes(problem, domain, 2)[0]
    formula = replace(problem, density=parse_formula("1+x"))
    np.testing.assert_allclose(elasticity.modes(formula, domain, 2)[0], found, rtol=1e-9)

    def at_the_ends(value: float) -> float:
        (a, _, b, _), (c, _, d, _) = (airy(-np.cbrt(value) * (1.0 + x)) for x in (0.0, 6.0))
        return float(a * d - b * c)

    # u'' + value (1 + x) u = 0, u(0) = u(6) = 0; a constant density of the same mass (4) gives 0.0685.
    exact = brentq(at_the_ends, 0.05, 0.1)
    assert abs(exact - np.pi**2 / 36 / 4) > 1e-3
    np.testing.assert_allclose(found[0], exact, rtol=1e-5)
    total = float(integral(domain, density))
    np.testing.assert_allclose(total, 24 * 4.0, rtol=1e-12)


def _run(main, arguments: list[str], capsys) -> dict:
    import json

    capsys.readouterr()
    assert main(arguments) in (0, None)
    return json.loads(capsys.readouterr().out)
