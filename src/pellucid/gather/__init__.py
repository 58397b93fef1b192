"""The hierarchical sum of the diffusion approximation over surface samples, which two methods share (JB02 section 3.2)."""
