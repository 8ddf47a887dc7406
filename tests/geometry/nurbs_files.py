"""Small NURBS files of every format, made for the tests."""

from __future__ import annotations

# Two cubes side by side along x, the second longer and with its own names; quadratic along y.
GEOPDES = """# nurbs mesh v.2.1
# two bricks
3 3 2 1 1
PATCH 1
1 2 1
2 3 2
0 0 1 1
0 0 0 1 1 1
0 0 1 1
0 1 0 0.8 0 1 0 1 0 0.8 0 1
0 0 0.4 0.4 1 1 0 0 0.4 0.4 1 1
0 0 0 0 0 0 1 1 0.8 0.8 1 1
1 1 0.8 0.8 1 1 1 1 0.8 0.8 1 1
PATCH 2
1 2 1
2 3 2
0 0 1 1
0 0 0 1 1 1
0 0 1 1
1 3 0.8 2.4 1 3 1 3 0.8 2.4 1 3
0 0 0.4 0.4 1 1 0 0 0.4 0.4 1 1
0 0 0 0 0 0 1 1 0.8 0.8 1 1
1 1 0.8 0.8 1 1 1 1 0.8 0.8 1 1
INTERFACE 1
1 2
2 1
1 1 1
SUBDOMAIN 1
1 2
BOUNDARY 1
1
1 1
hot end
1
2 2
"""

GISMO = """<?xml version="1.0" encoding="UTF-8"?>
<xml>
 <Geometry type="TensorBSpline3" id="4">
  <Basis type="TensorBSplineBasis3">
   <Basis type="BSplineBasis" index="0"><KnotVector degree="1">0 0 1 1</KnotVector></Basis>
   <Basis type="BSplineBasis" index="1"><KnotVector degree="1">0 0 1 1</KnotVector></Basis>
   <Basis type="BSplineBasis" index="2"><KnotVector degree="1">0 0 0.5 1 1</KnotVector></Basis>
  </Basis>
  <coefs geoDim="3">0 0 0 1 0 0 0 1 0 1 1 0 0 0 1 1 0 1 0 1 1 1 1 1 0 0 2 1 0 2 0 1 2 1 1 2</coefs>
 </Geometry>
 <Geometry type="TensorNurbs3" id="9">
  <Basis type="TensorNurbsBasis3">
   <Basis type="TensorBSplineBasis3">
    <Basis type="BSplineBasis" index="0"><KnotVector degree="1">0 0 1 1</KnotVector></Basis>
    <Basis type="BSplineBasis" index="1"><KnotVector degree="1">0 0 1 1</KnotVector></Basis>
    <Basis type="BSplineBasis" index="2"><KnotVector degree="1">0 0 1 1</KnotVector></Basis>
   </Basis>
   <weights>2 3 2 3 2 3 2 3</weights>
  </Basis>
  <coefs geoDim="3">1 0 0 2 0 0 1 1 0 2 1 0 1 0 2 2 0 2 1 1 2 2 1 2</coefs>
 </Geometry>
 <MultiPatch parDim="3" id="20">
  <patches type="id_index">9 4</patches>
  <interfaces>9 1 4 2 0 1 2 1 1 1</interfaces>
  <boundary name="floor">9 5
4 5</boundary>
  <boundary>9 2</boundary>
 </MultiPatch>
</xml>
"""

MFEM_PATCHES = """MFEM NURBS mesh v1.0
# the second cube is turned by half a revolution
dimension
3
elements
2
1 5 0 1 4 3 6 7 10 9
1 5 5 4 1 2 11 10 7 8
boundary
2
7 3 0 3 9 6
8 3 2 5 11 8
edges
20
0 0 1
1 1 4
0 3 4
1 0 3
2 1 2
1 2 5
2 4 5
0 6 7
1 7 10
0 9 10
1 6 9
2 7 8
1 8 11
2 10 11
3 0 6
3 1 7
3 2 8
3 3 9
3 4 10
3 5 11
vertices
12
patches
knotvectors
3
1 2 0 0 1 1
1 2 0 0 1 1
1 2 0 0 1 1
dimension
3
controlpoints
0 0 0 1   1 0 0 1   0 1 0 1   1 1 0 1   0 0 1 1   1 0 1 1   0 1 1 1   1 1 1 1
knotvectors
3
1 2 0 0 1 1
1 2 0 0 1 1
1 2 0 0 1 1
dimension
3
controlpoints_cartesian
2 1 0 1   1 1 0 1   2 0 0 1   1 0 0 1   2 1 1 1   1 1 1 1   2 0 1 1   1 0 1 1
"""

# The same two cubes with shared knot vectors, quadratic with one more knot along x in the first: the numbering of
# functions on edges, faces and inside patches, and a knot vector that runs backwards in the second patch.
_TOPOLOGY = MFEM_PATCHES[: MFEM_PATCHES.index("patches\n")]


def mfem_shared() -> str:
    """The two cubes as shared knots, weights and nodes; nodes follow from the numbering by hand (see the test)."""
    import numpy as np

    # Knot vectors: 0 along x of cube 0 (3 functions), 1 along y (4 functions, 0 0 0 .25 1 1 1), 2 along x of cube 1
    # (2 functions), 3 along z (2 functions).
    greville = {0: [0, 0.5, 1], 1: [0, 0.125, 0.625, 1], 2: [0, 1], 3: [0, 1]}
    vertices = {0: (0, 0, 0), 1: (1, 0, 0), 2: (2, 0, 0), 3: (0, 1, 0), 4: (1, 1, 0), 5: (2, 1, 0)}
    vertices |= {v + 6: (x, y, 1) for v, (x, y, _) in list(vertices.items())}
    lines = _TOPOLOGY.split("edges\n20\n")[1].split("vertices")[0].splitlines()
    nodes = [vertices[v] for v in range(12)]
    for k, a, b in (map(int, line.split()) for line in lines):
        low, high = (np.array(vertices[v], dtype=float) for v in (a, b))
        inside = [low + s * (high - low) for s in greville[k][1:-1]]
        nodes += [tuple(p) for p in (inside if a < b else inside[::-1])]
    # Only the faces in (x, y) of cube 0 have inner functions (1 x 2): its first face is numbered from vertex 3 along
    # x, then against y; its last from vertex 6 along x, then along y.
    nodes += [(0.5, y, 0) for y in (0.625, 0.125)] + [(0.5, y, 1) for y in (0.125, 0.625)]
    vectors = "4\n2 3 0 0 0 1 1 1\n2 4 0 0 0 .25 1 1 1\n1 2 0 0 1 1\n1 2 0 0 1 1\n"
    text = "\n".join(" ".join(f"{x:g}" for x in p) for p in nodes)
    space = "FiniteElementSpace\nFiniteElementCollection: NURBS\nVDim: 3\nOrdering: 1\n"
    return _TOPOLOGY + "knotvectors\n" + vectors + "weights\n" + "1\n" * len(nodes) + space + text + "\n"


FILES = {"geopdes.txt": GEOPDES, "gismo.xml": GISMO, "patches.mesh": MFEM_PATCHES, "shared.mesh": mfem_shared()}
