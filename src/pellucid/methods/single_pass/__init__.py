"""The single-pass method: cuts through light and irradiance clusters together (AWB08)."""
