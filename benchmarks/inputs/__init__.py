"""Bad inputs, generated from the public surface and written by hand; `benchmarks.claims.bad_input`
counts how they are answered.
"""
