"""Meshes: files, buffers, repair, normals."""
