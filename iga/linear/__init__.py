"""Linear algebra: solvers, factorizations, preconditioners, eigenpairs."""
