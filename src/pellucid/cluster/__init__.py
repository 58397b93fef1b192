"""Many machines: frames, tiles and light, by Dask's ``distributed``."""
