"""The algorithm of the paper: a cut of triples for every eye point (AWB08 section 4)."""
