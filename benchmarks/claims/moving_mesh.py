"""What it costs to let the mesh of a worn bearing follow its wall, by the number of cells; and the
worst shape of a cell, by worn depth in heights of the first layer.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, report, side_by_side

THICKNESS, THROUGH = 4e-3, 12


def main() -> None:
    options = arguments(__doc__)
    sizes = ((72, 20), (144, 60)) if options.quick else ((72, 20), (144, 60), (360, 120))
    cost, shape = [], []
    for around, along in sizes:
        rig = jc.scenes.four_bar("spatial", cells=(around, along))
        begun = time.process_time()
        solid = jc.mesh.solid(rig, "B", thickness=THICKNESS, cells=(around, along, THROUGH))
        built = time.process_time() - begun
        cells = len(solid.new.hexahedra())
        depth = jnp.asarray(np.random.default_rng(0).uniform(size=(around, along)))
        follow = jax.jit(lambda depth, solid=solid: solid.displacement(depth))
        times = side_by_side({"follow": lambda f=follow, d=depth: f(d)})["follow"]
        cost.append(
            {
                "cells": cells,
                "built once [CPU s]": built,
                "follows [CPU s]": times[1],
                "follows [CPU s per 1e5 cells]": times[1] / cells * 1e5,
            }
        )
        first = float(jnp.linalg.norm(jnp.diff(solid.new.points[solid.new.groups[0][0, 0, 0, :2]],
                                               axis=0)))  # fmt: skip
        for factor in (0.5, 1.0, 2.0, 4.0):
            worn = solid.worn(factor * first * depth)
            least = float(worn.scaled_jacobians().min())
            shape.append(
                {
                    "cells": cells,
                    "deepest cell [first layers]": factor,
                    "least scaled Jacobian [1]": least,
                }
            )
    report("moving mesh: cost", cost, options)
    report("moving mesh: shape, every cell of the map worn at random", shape, options)


if __name__ == "__main__":
    main()
