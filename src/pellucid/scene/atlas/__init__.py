"""A surface laid out in a texture, and its texels as surface samples (CLHHC08 section 3)."""
