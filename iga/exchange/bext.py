"""Bezier extraction files in the text format BEXT 2.0, the seam to LS-DYNA, Coreform and libMesh.

A patch is nodes (control points with weights), blocks of elements of equal type and degree, and a table of coefficient
vectors that the elements refer to. On an element with nodes A and coefficient vectors c_A

    N_A = sum_b c_A[b] B_b,    R_A = w_A N_A / sum_A w_A N_A,    x = sum_A R_A P_A.

What is written, line by line; numbers start at 1, integers ten and reals five to a line, comments begin with ``$#``:

    B E X T 2.0
    patch, nodes, elements, coefficient vectors, 1 if there are weights else 0
    x y z w                           one line for each node; Cartesian, not multiplied by the weight
    element blocks
    type, elements, nodes of each, vectors of each, degrees r s t          one line for each block; type 1
    node numbers (ascending); numbers of coefficient vectors               for each element
    dense blocks of vectors, sparse blocks (0)
    vectors, components of each       one line for each dense block
    components                        for each vector; Bernstein functions with r fastest, then s, then t

The directions r, s, t are our first, second and third reference axis. Only hexahedra are written and read: the order of
functions on other cells is not public. Boundary names travel in comments of our own, ``$# boundary NAME BLOCK FACE
COUNT`` followed by ``$#`` lines of element numbers; other programs skip them.

Axis letters: e element, n node of the element, b Bernstein function, k distinct pattern of coefficient vectors.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from iga.bernstein import bernstein
from iga.block import Block, Patterns, distinct_extractions
from iga.cells import HEXAHEDRON
from iga.domain import Domain, Facets, Provenance, Space, check
from iga.errors import FormatError, InputError
from iga.exchange.files import write_text
from iga.facets import exposed

Array = NDArray[np.float64]
Index = NDArray[np.int64]

INTEGERS, REALS = 10, 5
MAGIC = "B E X T 2.0"


# --- writing ---------------------------------------------------------------------------------------------------------


def write_bext(path: str | Path, domain: Domain) -> Path:
    """Write a domain of hexahedra.

    Raises
    ------
    InputError : a block holds other cells, the space is constrained, or the file cannot be written.
    """
    space = domain.space
    if space.constraint is not None:
        raise InputError("a space with constraints cannot be written as BEXT: it has no place for them")
    for number, block in enumerate(space.blocks):
        if block.basis.cell is not HEXAHEDRON:
            raise InputError(f"block {number} holds {block.basis.cell.name}s; BEXT files take hexahedra only")
    tables = [_vectors(block) for block in space.blocks]
    sizes = [table[0].shape[1] for table in tables]
    components = sorted(set(sizes))
    groups = [np.concatenate([t[0] for t, size in zip(tables, sizes) if size == m]) for m in components]
    vectors = [np.unique(group, axis=0, return_inverse=True) for group in groups]
    first = dict(zip(components, np.cumsum([1, *(len(v) for v, _ in vectors)])))
    at = dict.fromkeys(components, 0)
    elements, heads = [], []
    for block, (own, rows), size in zip(space.blocks, tables, sizes):
        inverse = vectors[components.index(size)][1].ravel()
        numbers = first[size] + inverse[at[size] : at[size] + len(own)]
        at[size] += len(own)
        order = np.argsort(block.dofs, axis=1)
        nodes = np.take_along_axis(block.dofs, order, axis=1) + 1
        elements.append(_interleaved(nodes, np.take_along_axis(numbers[rows], order, axis=1)))
        heads.append(_integers(np.array([[1, block.elements, block.n, block.n, *block.basis.degree]])))
    weights = np.ones(space.n) if space.weights is None else space.weights
    total = sum(len(v) for v, _ in vectors)
    count = space.elements
    head = np.array([[1, space.n, count, total, int(space.weights is not None)]])
    text = [
        MAGIC + "\n",
        _integers(head),
        _reals(np.column_stack([domain.points, weights])),
        _integers(np.array([[len(space.blocks)]])),
        *heads,
        *elements,
        _integers(np.array([[len(components), 0]])),
        *(_integers(np.array([[len(v), m]])) for (v, _), m in zip(vectors, components)),
        *(_reals(v) for v, _ in vectors),
        *_named(domain),
    ]
    write_text(path, "".join(text))
    return Path(path)


def _vectors(block: Block) -> tuple[Array, Index]:
    """Coefficient vectors (v, b) in the file's order of Bernstein functions, and their numbers (e, n)."""
    order = _bext_order(block.basis.degree)
    C, pattern = distinct_extractions(block)
    k, n, b = C.shape
    return C[..., order].reshape(k * n, b), pattern.reshape(-1, 1) * n + np.arange(n)


def _bext_order(degree: tuple[int, ...]) -> Index:
    """Our function for each of the file's: r fastest there, slowest here."""
    p, q, r = (d + 1 for d in degree)
    return np.arange(p * q * r).reshape(p, q, r).transpose(2, 1, 0).ravel()


def _lines(rows: Array | Index, form: str, width: int) -> str:
    """Rows of numbers, each broken into lines of at most ``width`` numbers."""
    count = rows.shape[1]
    breaks = [form * min(width, count - start) + "\n" for start in range(0, count, width)]
    return ("".join(breaks) * len(rows)) % tuple(rows.ravel().tolist())


def _integers(rows: Index) -> str:
    return _lines(rows, " %8d", INTEGERS)


def _reals(rows: Array) -> str:
    return _lines(rows, "%25.16E", REALS)


def _interleaved(nodes: Index, numbers: Index) -> str:
    """For each element the lines of its nodes, then those of its coefficient vectors."""
    count = nodes.shape[1]
    lines = "".join(" %8d" * min(INTEGERS, count - start) + "\n" for start in range(0, count, INTEGERS))
    return (lines * 2 * len(nodes)) % tuple(np.stack([nodes, numbers], axis=1).ravel().tolist())


def _named(domain: Domain) -> list[str]:
    text = []
    for name, facets in domain.boundaries.items():
        for f in facets:
            text.append(f"$# boundary {'_'.join(name.split())} {f.block + 1} {f.face + 1} {len(f.elements)}\n")
            rows = _lines(f.elements[None] + 1, " %8d", INTEGERS)
            text.append("".join("$#" + line + "\n" for line in rows.splitlines()))
    return text


# --- reading ---------------------------------------------------------------------------------------------------------


def read_bext(path: str | Path) -> Domain:
    """Read a file of hexahedra.

    Boundaries are those named in our comments, or else everything outside under the name "boundary".

    Raises
    ------
    FormatError : this is no BEXT 2.0 text file, it is cut off, or it holds what is not read (other cells, sparse
        vectors).
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise FormatError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if not lines or not lines[0].startswith(MAGIC):
        raise FormatError(f"{path}: the first line is not {MAGIC!r}")
    body = [line for line in lines[1:] if line.strip() and not line.startswith("$#")]
    _, nodes, count, total, rational = _whole(path, body, 0, 5, "patch header")[:5]
    places = _numbers(path, body[1 : 1 + nodes], 4 * nodes, "nodes").reshape(nodes, 4)
    blocks = _whole(path, body, 1 + nodes, 1, "number of element blocks")[0]
    heads = [_head(path, body, 2 + nodes + k, k) for k in range(blocks)]
    if sum(head[0] for head in heads) != count:
        raise FormatError(f"{path}: the blocks hold {sum(h[0] for h in heads)} elements; the patch header says {count}")
    rest = _numbers(path, body[2 + nodes + blocks :], None, "elements and coefficient vectors")
    at, tables = 0, []
    for elements, n, _ in heads:
        tables.append(_take_whole(path, rest, at, elements * 2 * n, "elements").reshape(elements, 2, n) - 1)
        at += elements * 2 * n
    dense, sparse = _take_whole(path, rest, at, 2, "coefficient blocks")
    if sparse:
        raise FormatError(f"{path}: holds sparse coefficient vectors, which are not read")
    shapes = _take_whole(path, rest, at + 2, 2 * dense, "coefficient blocks").reshape(dense, 2)
    at += 2 + 2 * dense
    vectors, first = [], [0]
    for number, size in shapes.tolist():
        vectors.append(_take(path, rest, at, number * size, "coefficient vectors").reshape(number, size))
        first.append(first[-1] + number)
        at += number * size
    if first[-1] != total:
        raise FormatError(f"{path}: holds {first[-1]} coefficient vectors; the patch header says {total}")
    starts = np.array(first)
    made = [_block(path, k, head, table, nodes, vectors, starts) for k, (head, table) in enumerate(zip(heads, tables))]
    space = Space(tuple(made), nodes, np.ascontiguousarray(places[:, 3]) if rational else None)
    domain = Domain(space, np.ascontiguousarray(places[:, :3]), provenance=Provenance("", path.name))
    try:
        check(domain)
    except InputError as error:
        raise FormatError(f"{path}: {error}") from None
    boundaries = _read_names(path, lines, made) or {"boundary": tuple(exposed(domain))}
    return Domain(space, domain.points, boundaries, provenance=domain.provenance)


def _block(
    path: Path, number: int, head: tuple[int, int, tuple[int, ...]], table: Index, nodes: int, vectors: list[Array],
    first: Index,
) -> Block:  # fmt: skip
    _, n, degree = head
    basis = bernstein(HEXAHEDRON, degree)
    dofs, ids = table[:, 0], table[:, 1]
    for what, values, limit in (("node", dofs, nodes), ("coefficient vector", ids, first[-1])):
        bad = np.argwhere((values < 0) | (values >= limit))
        if len(bad):
            wrong = values[tuple(bad[0])] + 1
            raise FormatError(f"{path}: element {bad[0][0] + 1} of block {number + 1} names {what} {wrong} of {limit}")
    group = np.searchsorted(first, ids, side="right") - 1
    if (group != group.flat[0]).any() or vectors[group.flat[0]].shape[1] != basis.n:
        raise FormatError(f"{path}: the coefficient vectors of block {number + 1} do not have {basis.n} components")
    own = vectors[group.flat[0]]
    rows, pattern = np.unique(ids, axis=0, return_inverse=True)
    C = np.empty((len(rows), n, basis.n))
    C[..., _bext_order(degree)] = own[rows - first[group.flat[0]]]
    identity = n == basis.n and len(C) == 1 and (C[0] == np.eye(n)).all()
    return Block(basis, np.ascontiguousarray(dofs), None if identity else Patterns(C, pattern.ravel()))


def _whole(path: Path, body: list[str], line: int, least: int, what: str) -> list[int]:
    """Whole numbers of one line, ``least`` of them or more."""
    try:
        found = [int(word) for word in body[line].split()]
    except IndexError:
        raise FormatError(f"{path}: ends before the {what}") from None
    except ValueError:
        raise FormatError(f"{path}: the {what} is not whole numbers: {body[line].strip()[:60]!r}") from None
    if len(found) < least or min(found) < 0:
        raise FormatError(f"{path}: the {what} needs {least} numbers: {body[line].strip()[:60]!r}")
    return found


def _head(path: Path, body: list[str], line: int, number: int) -> tuple[int, int, tuple[int, ...]]:
    """Elements, nodes of each, and degrees of a block."""
    found = _whole(path, body, line, 5, f"block {number + 1}")
    kind, elements, n, vectors, *degree = found
    if kind not in (0, 1) or len(degree) != 3:
        what = f"is of type {kind} and dimension {len(degree)}"
        raise FormatError(f"{path}: block {number + 1} {what}; only hexahedra (type 1, dimension 3) are read")
    if n != vectors or n == 0 or elements == 0 or min(degree) < 1:
        raise FormatError(f"{path}: block {number + 1} has {elements} elements of {n} nodes and {vectors} vectors")
    return elements, n, tuple(degree)


def _numbers(path: Path, lines: list[str], count: int | None, what: str) -> Array:
    try:
        found = np.array(" ".join(lines).split(), dtype=float)
    except ValueError as error:
        raise FormatError(f"{path}: the {what} hold what is no number: {error}") from None
    if count is not None and len(found) != count:
        raise FormatError(f"{path}: the {what} need {count} numbers, not {len(found)}")
    return found


def _take(path: Path, numbers: Array, at: int, count: int, what: str) -> Array:
    if count < 0 or at + count > len(numbers):
        raise FormatError(f"{path}: is cut off within the {what}")
    return numbers[at : at + count]


def _take_whole(path: Path, numbers: Array, at: int, count: int, what: str) -> Index:
    found = _take(path, numbers, at, count, what)
    if not ((np.abs(found) < 2.0**53) & (found == np.rint(found))).all():
        raise FormatError(f"{path}: the {what} hold numbers that are not whole")
    return found.astype(np.int64)


def _read_names(path: Path, lines: list[str], blocks: list[Block]) -> dict[str, tuple[Facets, ...]]:
    found: dict[str, tuple[Facets, ...]] = {}
    starts = [k for k, line in enumerate(lines) if line.startswith("$# boundary ")]
    for start in starts:
        words = lines[start].split()
        try:
            name, block, face, count = words[2], int(words[3]) - 1, int(words[4]) - 1, int(words[5])
            rows = lines[start + 1 : start + 1 + -(-count // INTEGERS)]
            elements = np.array(" ".join(line.removeprefix("$#") for line in rows).split(), dtype=np.int64) - 1
        except (IndexError, ValueError):
            raise FormatError(f"{path}, line {start + 1}: no boundary can be read from {lines[start][:60]!r}") from None
        sound = 0 <= block < len(blocks) and 0 <= face < 6 and len(elements) == count
        if not sound or (count and not (elements.min() >= 0 and elements.max() < blocks[block].elements)):
            raise FormatError(f"{path}, line {start + 1}: boundary {name!r} names what is not there")
        found[name] = (*found.get(name, ()), Facets(block, face, elements))
    return found
