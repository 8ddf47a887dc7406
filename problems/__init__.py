"""Heat conduction and linear elasticity: data, exact solutions, benchmark cases."""

from problems.case import solve_case
from problems.elasticity import Elasticity
from problems.formula import Formula, parse, parse_vector
from problems.heat import Heat
from problems.manufactured import solve_exact
from problems.solution import Solution

__all__ = ["Elasticity", "Formula", "Heat", "Solution", "parse", "parse_vector", "solve_case", "solve_exact"]
