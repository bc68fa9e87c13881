"""Mechanisms written by hand in NumPy, numba and C, and the engine beside them."""
