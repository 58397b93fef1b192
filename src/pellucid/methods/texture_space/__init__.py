"""Texture-space importance sampling and its hybrid with translucent shadow maps (CLHHC08)."""
