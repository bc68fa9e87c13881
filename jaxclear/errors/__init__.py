"""How far the numbers of a run are off: every number is an estimate, and its error the scatter of
replicas, runs of the same model in which everything that discretises it is refined.

Source: Roache 1994, J. Fluids Eng. 116, 405, doi:10.1115/1.2910291 (solution verification).
"""
