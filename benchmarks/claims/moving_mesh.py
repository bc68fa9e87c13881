"""What it costs to let the mesh of a worn bearing follow its wall, by the number of cells; and the
worst shape of a cell, by worn depth in heights of the first layer.
"""

import time

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import run_tables, side_by_side

THICKNESS, THROUGH = 4e-3, 12


def meshes(options):
    """(mesh, random depths of its map as shares of 1, CPU seconds to build it) by size."""
    for around, along in ((72, 20), (144, 60), (360, 120))[: 2 if options.quick else None]:
        rig, start = jc.scenes.four_bar("spatial", cells=(around, along)), time.process_time()
        solid = jc.mesh.solid(rig, "B", thickness=THICKNESS, cells=(around, along, THROUGH))
        built = time.process_time() - start
        depth = jnp.asarray(np.random.default_rng(0).uniform(size=(around, along)))
        yield solid, depth, built


def cost_rows(options):
    for solid, depth, built in meshes(options):
        follow, cells = eqx.filter_jit(solid.displacement), len(solid.new.hexahedra())
        cpu = side_by_side({"follow": lambda f=follow, d=depth: f(d)})["follow"][1]
        row = {"cells": cells, "built once [CPU s]": built, "follows [CPU s]": cpu}
        yield row | {"follows [CPU s per 1e5 cells]": cpu / cells * 1e5}


def shape_rows(options):
    for solid, depth, _ in meshes(options):
        ends = solid.new.points[solid.new.groups[0][0, 0, 0, :2]]
        first = float(jnp.linalg.norm(ends[1] - ends[0]))
        for factor in (0.5, 1.0, 2.0, 4.0):
            least = float(solid.worn(factor * first * depth).scaled_jacobians().min())
            row = {"cells": len(solid.new.hexahedra()), "deepest cell [first layers]": factor}
            yield row | {"least scaled Jacobian [1]": least}


TABLES = {
    "Moving mesh: cost": cost_rows,
    "Moving mesh: shape, every cell of the map worn at random": shape_rows,
}

if __name__ == "__main__":
    run_tables(TABLES)
