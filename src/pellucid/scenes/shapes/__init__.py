"""What the built-in scenes are shaped with: turned and rounded solids, boxes, level sets, decimation, painted textures."""
