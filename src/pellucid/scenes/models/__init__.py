"""Seven closed meshes: stand-ins for the models of table 2 of CLHHC08."""
