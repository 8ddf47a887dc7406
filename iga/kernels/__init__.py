"""Compiled kernels: plain arrays in, plain arrays out.

They release Python's global lock and are compiled once per degree (for literal loop bounds, where that pays) and
cached on disk. No kernel knows domains or spaces; `iga.assembly` and `iga.operator` put them behind names.
"""
