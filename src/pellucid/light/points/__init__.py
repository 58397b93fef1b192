"""All light of a scene as point lights, which a kernel can sum over or cluster (AWB08 section 4.1)."""
