"""A function of one cell over millions: devices, cores, workers, progress."""
