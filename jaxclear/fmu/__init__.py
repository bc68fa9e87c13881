"""A mechanism as an FMI 3.0 unit: machine code of its start, its steps and what is read from them,
for simulators of systems that have neither Python nor JAX.
"""
