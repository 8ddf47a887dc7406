"""The core: reference cells, bases, blocks, domains, fields, assembly, solvers, certificates, export.

The names below are the ones most programs use, from a domain to a solution. All else is imported from its module:

    cells, bernstein, quadrature            reference cells, their bases and rules
    block, domain, field, chunk             functions on elements, solids, fields, and elements at points
    conforming, refinement, conformity      meshes of mixed cells, finer ones, and what jumps between cells
    integrands, assembly, operator          forms, their sparse matrices, and products without a matrix
    conditions, nitsche, linear, norms      boundary values strong and weak, solvers and eigenpairs, errors
    certificate, scaled_jacobian            proofs of validity, measures of shape
    untangling, tether                      control points moved until elements are valid and well shaped
    locate, sampling, facets                elements of points, values at reference points, what lies outside
    store, exchange, pictures               domain files, files for other programs, pictures
"""

from iga.assembly import integral, matrix, vector, volume
from iga.certificate import certify
from iga.conditions import dirichlet
from iga.domain import Domain, Space
from iga.errors import ConvergenceError, FormatError, InputError
from iga.field import Field
from iga.linear.solvers import solve
from iga.store import load, save

__all__ = [
    "ConvergenceError", "Domain", "Field", "FormatError", "InputError", "Space", "certify", "dirichlet", "integral",
    "load", "matrix", "save", "solve", "vector", "volume",
]
