"""Triangulated surfaces and other simplicial meshes: reading, mending, paths, cuts, closest points, maps, smoothing."""
