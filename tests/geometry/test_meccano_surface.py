"""Reading, checking and mending surfaces, and distances between them."""

from __future__ import annotations

import struct
from pathlib import Path

import meshio
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from geometry.simplices.closest import closest
from geometry.simplices.distance import distances, samples
from geometry.simplices.reading import read_surface, reads
from geometry.simplices.surface import Surface, checked_surface, edge_rows, genus, volume
from iga.errors import FormatError, InputError

OCTAHEDRON = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], dtype=float)
FACES = np.array([(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)])


def ball(level: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Points and triangles of a sphere, from an octahedron."""
    points, triangles = OCTAHEDRON, FACES
    for _ in range(level):
        corners = points[triangles]
        middle = (corners + np.roll(corners, -1, axis=1)) / 2
        a, b, c = corners.transpose(1, 0, 2)
        p, q, r = middle.transpose(1, 0, 2)
        flat = np.stack([a, p, r, p, b, q, r, q, c, p, q, r], axis=1).reshape(-1, 3)
        flat = np.round(flat / np.linalg.norm(flat, axis=1)[:, None], 12)
        points, inverse = np.unique(flat, axis=0, return_inverse=True)
        triangles = inverse.reshape(-1, 3)
    return points, triangles


def torus(n: int = 12, m: int = 8) -> tuple[np.ndarray, np.ndarray]:
    i, j = (x.ravel() for x in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    u, v = 2 * np.pi * i / n, 2 * np.pi * j / m
    points = np.stack([(2 + 0.7 * np.cos(v)) * np.cos(u), (2 + 0.7 * np.cos(v)) * np.sin(u), 0.7 * np.sin(v)], axis=1)
    a, b = i * m + j, (i + 1) % n * m + j
    c, d = (i + 1) % n * m + (j + 1) % m, i * m + (j + 1) % m
    return points, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def write(path: Path, points: np.ndarray, triangles: np.ndarray) -> Path:
    options: dict = {"binary": True} if path.suffix == ".stl" else {}
    meshio.write(path, meshio.Mesh(points, [("triangle", triangles)]), **options)
    return path


@pytest.mark.parametrize("ending", [".stl", ".obj", ".off", ".ply"])
def test_formats(tmp_path, ending):
    points, triangles = ball()
    path = write(tmp_path / f"ball{ending}", points, triangles)
    surface, report = read_surface(path)
    assert reads(path)
    assert (report["vertices"], report["triangles"], report["genus"]) == (66, 128, 0)
    exact = volume(Surface(points, triangles))
    assert abs(volume(surface) - exact) < (1e-6 if ending in (".stl",) else 1e-12) * exact


def test_genus_and_turning():
    points, triangles = torus()
    surface, report = checked_surface(points, triangles)
    assert report["genus"] == genus(surface) == 1
    turned, told = checked_surface(points, triangles[:, ::-1])
    assert "turned" in told
    assert abs(volume(turned) - volume(surface)) < 1e-14
    assert "turned" not in report


def broken(kind: str) -> tuple[np.ndarray, np.ndarray, str]:
    points, triangles = ball(1)
    points, triangles = points.copy(), triangles.copy()
    if kind == "open":
        return points, triangles[1:], "belongs to one triangle only"
    if kind == "edge":
        return points, np.concatenate([triangles, triangles[:1]]), "belongs to 3 triangles"
    if kind == "orientation":
        triangles[3] = triangles[3, ::-1]
        return points, triangles, "opposite orientations"
    if kind == "shells":
        return np.concatenate([points, points + 5]), np.concatenate([triangles, triangles + len(points)]), "2 shells"
    if kind == "nan":
        points[4, 1] = np.nan
        return points, triangles, "vertex 4 has a coordinate"
    if kind == "range":
        triangles[2, 0] = 99
        return points, triangles, "triangle 2 names a vertex"
    if kind == "degenerate":
        points[triangles[0, 0]] = points[triangles[0, 1]]
        return points, triangles, "degenerate"
    if kind == "vertex":
        # Two balls with one vertex in common.
        other = np.where(triangles == 0, 0, triangles + len(points))
        moved = points + 2.0 * points[0]
        moved[0] = points[0]
        second = np.concatenate([points, moved])
        second[len(points) :] = 2 * points[0] - points
        return second, np.concatenate([triangles, other[:, ::-1]]), "fans"
    if kind == "flat":
        flat = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=float)
        return flat, np.array([(0, 1, 2), (0, 2, 3), (0, 2, 1), (0, 3, 2)]), "triangle|volume"
    # Pull the top through the bottom.
    points[np.argmax(points[:, 2])] = (0, 0, -3)
    return points, triangles, "cross each other"


KINDS = ["open", "edge", "orientation", "shells", "nan", "range", "degenerate", "vertex", "flat", "crossing"]


@pytest.mark.parametrize("kind", KINDS)
def test_what_bounds_no_solid_is_refused_in_one_line(tmp_path, kind):
    points, triangles, message = broken(kind)
    with pytest.raises(InputError, match=message) as caught:
        checked_surface(points, triangles)
    assert "\n" not in str(caught.value)
    if kind != "range":
        path = write(tmp_path / "broken.off", points, triangles)
        with pytest.raises(InputError, match=r"broken\.off: ") as caught:
            read_surface(path)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["open", "orientation", "degenerate"])
def test_mending(tmp_path, kind):
    points, triangles, _ = broken(kind)
    _, report = read_surface(write(tmp_path / "broken.off", points, triangles), mend=True)
    assert report["genus"] == 0
    whole = volume(Surface(*ball(1)))
    assert abs(report["volume"] - whole) < (1e-12 if kind != "degenerate" else 0.3) * whole


def test_crossings_may_be_reported():
    points, triangles, _ = broken("crossing")
    _, report = checked_surface(points, triangles, crossings=True)
    assert report["crossing_pairs"] > 0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_crossings_are_found_as_by_brute_force(seed):
    rng = np.random.default_rng(seed)
    points, triangles = ball(1)
    points = points * rng.uniform(0.2, 1.8, (len(points), 1))
    # Star-shaped, so nothing crosses; then one vertex is pushed far through the other side.
    assert "crossing_pairs" not in checked_surface(points, triangles, crossings=True)[1]
    points[0] = -4 * points[0] + rng.normal(0, 0.1, 3)
    found = checked_surface(points, triangles, crossings=True)[1]["crossing_pairs"]
    count = 0
    for s in range(len(triangles)):
        for t in range(s + 1, len(triangles)):
            shared = set(triangles[s]) & set(triangles[t])
            if len(shared) < 2:
                count += any(
                    pierces(points[list(edge)], points[other])
                    for one, other in ((triangles[s], triangles[t]), (triangles[t], triangles[s]))
                    for edge in zip(one, np.roll(one, -1)) if not set(edge) & shared
                )
    assert found == count > 0


def pierces(segment: np.ndarray, triangle: np.ndarray) -> bool:
    """Solve for the point that the segment and the triangle have in common."""
    matrix = np.stack([segment[1] - segment[0], triangle[0] - triangle[1], triangle[0] - triangle[2]], axis=1)
    r, u, v = np.linalg.solve(matrix, triangle[0] - segment[0])
    return bool(0 < r < 1 and u > 0 and v > 0 and u + v < 1)


def test_obj_texture_seams_and_negative_numbers(tmp_path):
    points, triangles = ball(1)
    lines = [f"v {x} {y} {z}" for x, y, z in points] + [f"vt {k} 0" for k in range(3 * len(triangles))]
    lines += ["f " + " ".join(f"{v + 1}/{3 * t + i + 1}" for i, v in enumerate(row)) for t, row in enumerate(triangles)]
    (tmp_path / "seams.obj").write_text("\n".join(lines))
    assert read_surface(tmp_path / "seams.obj")[1]["vertices"] == 18
    lines = [f"v {x} {y} {z}" for x, y, z in points]
    lines += ["f " + " ".join(str(v - len(points)) for v in row) for row in triangles]
    (tmp_path / "back.obj").write_text("\n".join(lines))
    assert read_surface(tmp_path / "back.obj")[1]["vertices"] == 18


def test_quadrilaterals_are_cut(tmp_path):
    cube = "\n".join(f"v {x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1))
    quads = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    (tmp_path / "cube.obj").write_text(cube + "\n" + "\n".join("f " + " ".join(map(str, q)) for q in quads))
    surface, report = read_surface(tmp_path / "cube.obj")
    assert report["quadrilaterals"] == 6
    assert abs(volume(surface) - 1) < 1e-15


def test_stl_points_that_touch_stay_apart(tmp_path):
    points, triangles = ball(1)
    # Two limbs of one shell that touch in a point: a ball whose poles are bent to the same place from two sides.
    poles = np.argsort(points[:, 2])[[0, -1]]
    points = points.copy()
    points[poles] = [(0, 0, 0)]
    records = b"".join(struct.pack("<12fH", 0, 0, 0, *points[t].ravel(), 0) for t in triangles)
    (tmp_path / "touch.stl").write_bytes(b"x" * 80 + struct.pack("<I", len(triangles)) + records)
    _, report = read_surface(tmp_path / "touch.stl")
    assert (report["vertices"], report["genus"]) == (18, 0)


def original(tmp_path: Path, ending: str) -> bytes:
    return write(tmp_path / f"good{ending}", *ball(1)).read_bytes()


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True,
          phases=[Phase.explicit, Phase.generate])
@given(data=st.data(), ending=st.sampled_from([".stl", ".obj", ".off", ".ply"]))
def test_damaged_files_give_one_line(tmp_path, data, ending):
    content = bytearray(original(tmp_path, ending))
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(content) - 1))
        how = data.draw(st.sampled_from(["byte", "cut", "insert", "zero"]))
        if how == "byte":
            content[place] = data.draw(st.integers(0, 255))
        elif how == "cut":
            del content[place : place + data.draw(st.integers(1, 60))]
        elif how == "insert":
            content[place:place] = data.draw(st.binary(min_size=1, max_size=12))
        else:
            content[place : place + 4] = bytes(4)
        if not content:
            content = bytearray(b" ")
    path = tmp_path / f"bad{ending}"
    path.write_bytes(bytes(content))
    reads(path)
    for mend in (False, True):
        try:
            surface, report = read_surface(path, mend=mend)
        except InputError as error:
            assert "\n" not in str(error)
            assert f"bad{ending}" in str(error)
        else:
            assert report["genus"] >= 0
            assert volume(surface) > 0


def test_files_that_are_no_surfaces(tmp_path):
    contents = {"a.stl": b"", "a.off": b"OFF\n", "a.ply": b"ply\n", "a.obj": b"\x00\xff", "a.txt": b"hello"}
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=name):
            read_surface(tmp_path / name)
    with pytest.raises(FormatError, match="no such file"):
        read_surface(tmp_path / "none.off")
    assert not reads(tmp_path / "a.txt")
    assert not reads(tmp_path / "none.off")


def test_closest_points_and_distances():
    points, triangles = ball(3)
    surface = Surface(points, triangles)
    rng = np.random.default_rng(9)
    queries = rng.normal(size=(300, 3))
    found, distance, owner = closest(points, triangles, queries)
    assert np.abs(np.linalg.norm(found - queries, axis=1) - distance).max() < 1e-15
    # Brute force over a fine sample of all triangles bounds it from above, and is near.
    dense = samples(points, triangles, 0.02)
    brute = np.linalg.norm(queries[:, None] - dense[None], axis=2).min(axis=1)
    assert (distance <= brute + 1e-14).all()
    assert (brute - distance).max() < 0.01
    normal = np.cross(*(points[triangles[owner]][:, k] - points[triangles[owner]][:, 0] for k in (1, 2)))
    assert np.abs(((found - points[triangles[owner, 0]]) * normal).sum(axis=1)).max() < 1e-14
    shifted = distances(surface, points + np.array([0.01, 0, 0]), triangles)
    assert shifted["to_input"] <= 0.01 + 1e-14
    assert shifted["from_input"] <= 0.01 + 1e-14
    assert shifted["relative"] > 0.8 * 0.01 / surface.diagonal
    # A spike is far from the sphere only one way.
    spiked = points.copy()
    spiked[0] *= 3
    one = distances(surface, spiked, triangles)
    assert abs(one["to_input"] - 2) < 0.02
    assert one["from_input"] < 0.5


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(1e-4, 1.0), st.floats(0.01, 0.5))
def test_samples_leave_no_gap_and_needles_have_few(seed, thin, step):
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(3, 3))
    corners /= np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max()
    foot = corners[0] + rng.uniform() * (corners[1] - corners[0])
    corners[2] = foot + thin * (corners[2] - foot)
    found = samples(corners, np.arange(3)[None], step)
    places = rng.dirichlet(np.full(3, 0.5), size=200) @ corners
    assert np.linalg.norm(places[:, None] - found[None], axis=2).min(axis=1).max() <= step
    # As many as squares of half a step over the longest side and the height, and some for each row's ends.
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    height = np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0])) / sides.max()
    assert len(found) <= 8 * (sides.max() / step + 2) * (height / step + 2)


MODELS = {
    "airplane1.off": (9417, 18830, 0, 0.072948), "bob_small.ply": (250, 500, 1, 0.67915),
    "bone.off": (6046, 12088, 0, 0.024787), "bunny_22k.off": (11247, 22490, 0, 1.3066),
    "bunny_7k.off": (3485, 6966, 0, 0.00075393), "eight.off": (5544, 11092, 2, 0.038973),
    "fertility.off": (4494, 9000, 4, 4.3219e5), "horse.off": (19851, 39698, 0, 0.042666),
    "idler_riser.stl": (782, 1572, 3, 1.4878), "kitten.off": (10183, 20366, 1, 97405),
    "spot.obj": (2930, 5856, 0, 0.71826),
}


@pytest.mark.parametrize("name", MODELS)
def test_models(data, name):
    _, report = read_surface(data / "surface" / name)
    vertices, triangles, handles, size = MODELS[name]
    assert (report["vertices"], report["triangles"], report["genus"]) == (vertices, triangles, handles)
    assert abs(report["volume"] / size - 1) < 5e-5


def test_models_that_bound_no_solid(data):
    with pytest.raises(InputError, match="cross each other"):
        read_surface(data / "surface" / "cow.off")
    _, report = read_surface(data / "surface" / "cow.off", crossings=True)
    assert (report["vertices"], report["genus"], report["crossing_pairs"]) == (2762, 0, 83)
    with pytest.raises(InputError, match="223 such edges"):
        read_surface(data / "surface" / "stanford_bunny_69k.obj")


def test_edges_are_found_by_their_vertices():
    points, triangles = ball(2)
    surface = Surface(points, triangles)
    pairs = np.roll(surface.edges[::-3], 1, axis=1)
    assert (surface.edges[edge_rows(surface, pairs)] == surface.edges[::-3]).all()
    assert edge_rows(surface, pairs[:0]).shape == (0,)
    far = int(np.argmax(np.linalg.norm(points - points[0], axis=1)))
    with pytest.raises(InputError, match=f"no edge of the surface joins the vertices {far} and 0$"):
        edge_rows(surface, np.array([pairs[0], (far, 0)]))
