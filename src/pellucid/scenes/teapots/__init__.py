"""The teapot: alone, under a sky, and on a small table."""
