"""A hall of columns after the Mezquita of Cordoba: the third scene of AWB08."""
