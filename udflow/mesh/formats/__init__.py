"""Writers of mesh and point files, one module a format. Use `udflow.mesh.export`."""
