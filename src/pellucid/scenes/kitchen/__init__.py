"""White and black marble on a kitchen table: the second scene of AWB08."""
