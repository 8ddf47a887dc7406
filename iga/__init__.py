"""The core: reference cells, bases, blocks, domains, fields, assembly, solvers, certificates, export."""
