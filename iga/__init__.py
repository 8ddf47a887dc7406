"""The core: reference cells, bases, blocks, domains, fields, assembly, solvers, certificates, export.

Import what is needed from the modules; the names below are the ones most programs use.
"""

from iga.assembly import integral, matrix, vector, volume
from iga.domain import Domain, Space
from iga.errors import InputError
from iga.field import Field
from iga.store import load, save

__all__ = ["Domain", "Field", "InputError", "Space", "integral", "load", "matrix", "save", "vector", "volume"]
