"""Saving and loading of domains in one compressed ``.npz`` file of plain arrays, without pickle.

Layout (version 1). ``header`` is a UTF-8 JSON text as a uint8 array:

    {"format": "iga-domain", "version": 1, "n": functions, "blocks": [{"cell", "degree", "extraction"}, ..],
     "boundaries": {name: [[block, face], ..]}, "attributes": [name, ..],
     "provenance": {"source", "input", "parameters", "arrays": [name, ..]}, "report": {..}}

and the arrays are

    points (n, 3); weights (n,) if rational; constraint_data, constraint_indices, constraint_indptr, constraint_shape
    block{k}_dofs (e, n); block{k}_parent (e,)              parent if present
    block{k}_C (k, n, b), block{k}_pattern (e,)             extraction "patterns"
    block{k}_factor{d} (k_d, n_d, b_d), block{k}_pattern (e, d)     extraction "kronecker"
    boundary{i}_{j} (f,)                                    elements of the j-th facets of the i-th name
    attribute{i}; provenance{i}
"""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from iga.bernstein import bernstein
from iga.block import Block, Extraction, Kronecker, Patterns
from iga.cells import CELLS
from iga.domain import Domain, Facets, Provenance, Space, check
from iga.errors import FormatError, InputError
from iga.exchange.files import replacing

VERSION = 1


def save(domain: Domain, path: str | Path) -> None:
    """Save a domain; the file appears under its name only when it is complete.

    Raises
    ------
    InputError : the file cannot be written.
    """
    space = domain.space
    arrays: dict[str, NDArray[Any]] = {"points": domain.points}
    blocks = []
    if space.weights is not None:
        arrays["weights"] = space.weights
    if space.constraint is not None:
        T = space.constraint
        arrays |= {
            "constraint_data": T.data, "constraint_indices": T.indices, "constraint_indptr": T.indptr,
            "constraint_shape": np.array(T.shape),
        }
    for k, block in enumerate(space.blocks):
        kind = "identity"
        arrays[f"block{k}_dofs"] = block.dofs
        if block.parent is not None:
            arrays[f"block{k}_parent"] = block.parent
        if isinstance(block.extraction, Patterns):
            kind = "patterns"
            arrays[f"block{k}_C"], arrays[f"block{k}_pattern"] = block.extraction.C, block.extraction.pattern
        elif isinstance(block.extraction, Kronecker):
            kind = "kronecker"
            arrays[f"block{k}_pattern"] = block.extraction.pattern
            for d, factor in enumerate(block.extraction.factors):
                arrays[f"block{k}_factor{d}"] = factor
        blocks.append({"cell": block.basis.cell.name, "degree": block.basis.degree, "extraction": kind})
    boundaries: dict[str, list[list[int]]] = {}
    for i, (name, facets) in enumerate(domain.boundaries.items()):
        boundaries[name] = [[f.block, f.face] for f in facets]
        arrays |= {f"boundary{i}_{j}": f.elements for j, f in enumerate(facets)}
    arrays |= {f"attribute{i}": np.asarray(a) for i, a in enumerate(domain.attributes.values())}
    origin = domain.provenance
    arrays |= {f"provenance{i}": np.asarray(a) for i, a in enumerate(origin.arrays.values())}
    header = {
        "format": "iga-domain", "version": VERSION, "n": space.n, "blocks": blocks, "boundaries": boundaries,
        "attributes": list(domain.attributes),
        "provenance": {
            "source": origin.source, "input": origin.input, "parameters": dict(origin.parameters),
            "arrays": list(origin.arrays),
        },
        "report": dict(domain.report),
    }
    text = json.dumps(header, default=_plain).encode()
    arrays["header"] = np.frombuffer(text, dtype=np.uint8)
    # Extraction matrices hold few different numbers: the quickest compression makes them eight times smaller.
    deflated = zipfile.ZIP_DEFLATED
    with replacing(path) as temporary, zipfile.ZipFile(temporary, "w", deflated, compresslevel=1) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, np.asanyarray(array), allow_pickle=False)


def load(path: str | Path) -> Domain:
    """Load a domain that `save` wrote, and check it.

    Raises
    ------
    FormatError : not such a file, or a truncated or altered one.
    """
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        header = json.loads(bytes(arrays["header"]).decode())
        if header["format"] != "iga-domain":
            raise FormatError(f"{path} holds no domain")
        if header["version"] != VERSION:
            raise FormatError(f"{path} has layout version {header['version']}; this program reads version {VERSION}")
        domain = _domain(header, arrays)
        check(domain)
    except FileNotFoundError:
        raise FormatError(f"{path} does not exist") from None
    except InputError as error:
        raise FormatError(f"{path}: {error}") from None
    except (OSError, EOFError, KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, MemoryError,
            zipfile.BadZipFile, RecursionError, NotImplementedError) as error:
        if not zipfile.is_zipfile(path):
            raise FormatError(f"{path} is not a saved domain; `iga build` makes one of a mesh or CAD file") from None
        raise FormatError(f"{path} is not a saved domain ({type(error).__name__}: {error})".splitlines()[0]) from None
    except Exception as error:  # zlib.error, struct.error and tokenize.TokenError (of array headers) share no base
        if type(error).__module__ not in ("zlib", "struct", "tokenize"):
            raise
        raise FormatError(f"{path} is damaged ({error})") from None
    return domain


def _domain(header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Domain:
    blocks = []
    for k, entry in enumerate(header["blocks"]):
        basis = bernstein(CELLS[entry["cell"]], tuple(entry["degree"]))
        extraction: Extraction = None
        if entry["extraction"] == "patterns":
            extraction = Patterns(_floats(arrays[f"block{k}_C"]), _integers(arrays[f"block{k}_pattern"]))
        elif entry["extraction"] == "kronecker":
            factors = tuple(_floats(arrays[f"block{k}_factor{d}"]) for d in range(basis.cell.dim))
            extraction = Kronecker(factors, _integers(arrays[f"block{k}_pattern"]))
        parent = arrays.get(f"block{k}_parent")
        blocks.append(Block(basis, _integers(arrays[f"block{k}_dofs"]), extraction, parent))
    constraint = None
    if "constraint_data" in arrays:
        entries = tuple(arrays[f"constraint_{part}"] for part in ("data", "indices", "indptr"))
        constraint = csr_array(entries, shape=tuple(int(s) for s in arrays["constraint_shape"]))
        constraint.check_format(full_check=True)
    weights = _floats(arrays["weights"]) if "weights" in arrays else None
    boundaries = {
        name: tuple(Facets(int(b), int(f), _integers(arrays[f"boundary{i}_{j}"])) for j, (b, f) in enumerate(facets))
        for i, (name, facets) in enumerate(header["boundaries"].items())
    }
    attributes = {name: _floats(arrays[f"attribute{i}"]) for i, name in enumerate(header["attributes"])}
    origin = header["provenance"]
    given = {name: arrays[f"provenance{i}"] for i, name in enumerate(origin["arrays"])}
    provenance = Provenance(origin["source"], origin["input"], origin["parameters"], given)
    space = Space(tuple(blocks), int(header["n"]), weights, constraint)
    return Domain(space, _floats(arrays["points"]), boundaries, attributes, provenance, header["report"])


def _floats(array: NDArray[Any]) -> NDArray[np.float64]:
    return np.ascontiguousarray(array, dtype=np.float64)


def _integers(array: NDArray[Any]) -> NDArray[np.int64]:
    if array.dtype.kind not in "iu":
        raise ValueError(f"integers expected, not {array.dtype}")
    return np.ascontiguousarray(array, dtype=np.int64)


def _plain(value: Any) -> Any:
    """NumPy numbers and arrays for JSON."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    raise InputError(f"a report or parameter holds a {type(value).__name__}, which cannot be saved")
