"""From what was asked for to pictures in files: what the command line and a cluster of machines share."""
