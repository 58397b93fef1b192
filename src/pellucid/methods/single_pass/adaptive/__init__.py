"""Our algorithm: light is measured only where it is seen, and as well as it is seen."""
