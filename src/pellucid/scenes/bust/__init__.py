"""A head of skin with a painted reflectance, in place of the face in figure 6 of JB02."""
