"""The parts of `benchmarks.attack`: mechanisms, laws and rungs drawn at random, and what is
measured of their runs.
"""
