"""Translucent bodies in real time: light, material, size and camera may all change from frame to frame."""
