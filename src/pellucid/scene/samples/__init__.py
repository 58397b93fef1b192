"""Samples spread over surfaces, and the area that each stands for (JB02 section 3.1)."""
