"""The 3RSR parallel mechanism: what a user waits for first, what a cycle with wear costs alone and
in a batch, and what a worn socket does to the peaks of force: read smoothly, with the stiffness of
the radius as made or as worn, and as one radius for each cell.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import about, alone, arguments, report, side_by_side
from jaxclear.commands import parallel_3rsr as study
from jaxclear.components.clearance import AbstractClearance, BallSocket
from jaxclear.ground.numerics import direction_angle
from jaxclear.ground import sparse as sp
from jaxclear.scenes.parallel_3rsr import QUIET, RATTLING, parallel_3rsr

FIRST = """
import time
import jaxclear as jc
rig = jc.scenes.parallel_3rsr({kind!r}, period=1.0)
begun = time.process_time()
run = jc.simulate(rig, 1.0, save=201)
ran = time.process_time()
run.reaction("S2").force.block_until_ready()
print(ran - begun, time.process_time() - ran)
"""
INTEGRATORS = {
    "Adaptive()": jc.integrator.Adaptive(),
    "ImplicitStep(2e-5)": jc.integrator.ImplicitStep(2e-5),
    "MoreauJean(5e-4)": jc.integrator.MoreauJean(5e-4),
}
SAMPLES, SAVES = 64, 201
# Starts that differ by rounding, nearly: shares of the clearance.
SEEDS = 1e-6 * np.arange(5)
STIFF_AS_WORN = "worn, smooth, stiffness of the worn radius"
FACETTED = "worn, a radius for each cell"


class FacettedSocket(AbstractClearance):
    """A ball socket whose worn surface has one radius for each cell, with steps between."""

    ideal_rows = ("x", "y", "z")
    socket: BallSocket

    @property
    def axes(self):
        return ()

    @property
    def clearance(self):
        return self.socket.clearance

    def contact_laws(self):
        return self.socket.contact_laws()

    def indentations(self, offset, axes, worn):
        if "socket" not in worn:
            return self.socket.indentations(offset, axes, worn)
        x, y, z = offset
        around, along = self.socket.socket_wear.cells
        column = direction_angle(x, y) * (around / (2 * jnp.pi))
        row = (direction_angle(jnp.hypot(x, y), z) / jnp.pi + 0.5) * along
        column = jnp.floor(column).astype(int) % around
        row = jnp.clip(jnp.floor(row).astype(int), 0, along - 1)
        return (sp.norm(offset) - self.clearance - worn["socket"][column, row],)

    def contact_candidates(self, offset, axes, indentations):
        return self.socket.contact_candidates(offset, axes, indentations)

    def maps(self):
        return self.socket.maps()

    def features(self, surface, offset, axes, indentations, index):
        return self.socket.features(surface, offset, axes, indentations, index)

    def coordinate_form(self):
        return self.socket.coordinate_form()


def first_rows():
    """CPU seconds of the first run and the first reaction in a new process, nothing kept."""
    environment = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    environment["PYTHONPATH"] = str(Path(__file__).parents[2])
    rows = []
    for kind in ("ideal", "one"):
        program = [sys.executable, "-c", FIRST.format(kind=kind)]
        done = subprocess.run(program, env=environment, capture_output=True, text=True, check=True)
        ran, read = map(float, done.stdout.split())
        rows.append({"balls with play": kind, "first run [s]": ran, "first reaction [s]": read})
    return rows


def question(integrator):
    """Worn volume of a cycle over the clearance."""
    return jc.Problem(
        parallel_3rsr("one", period=QUIET),
        {"worn volume": lambda run: run.worn_volume("S1", "socket")[-1]},
        {"clearance": jc.Variable(lambda m: m.connections["S1"].joint.clearance, tolerance=5e-5)},
        duration=QUIET,
        integrator=integrator,
        save=SAVES,
    )


def cost_rows(samples):
    """CPU time of a cycle alone, and of one in a batch."""
    rows = []
    for name, integrator in INTEGRATORS.items():
        asked = question(integrator)
        together = {"": lambda a=asked: jc.monte_carlo(a, samples, chunk=samples).responses}
        rows.append(
            {
                "integrator": name,
                "alone [s]": alone(asked, 3)[1],
                f"of {samples} [ms]": 1e3 * side_by_side(together, 2)[""][1] / samples,
            }
        )
    return rows


def peaks_rows(periods, seeds):
    """Largest deviation of the force from the ideal one over the third cycle, with the surface new,
    worn and smooth (as stiff as made, or as the worn radius), and worn with a radius for each cell:
    least and most over the starts."""
    worn = study.simulated(parallel_3rsr("one", period=QUIET), study.DENSE * QUIET)
    depth = study.FACTOR * (40 / study.DENSE) * worn.worn_depth("S1", "socket")
    states = {"new": None, "worn, smooth": depth, STIFF_AS_WORN: depth, FACETTED: depth}
    rows = []
    for period in periods:
        ideal = study.ideal_run(period)
        for surface, start in states.items():
            found = []
            for seed in seeds:
                follows = surface == STIFF_AS_WORN
                rig = parallel_3rsr("one", 5e-4 * (1 + seed), period=period, worn_radius=follows)
                if surface == FACETTED:
                    where = lambda m: m.connections["S1"].joint
                    rig = eqx.tree_at(where, rig, FacettedSocket(where(rig)))
                state = None if start is None else jc.State({"S1": {"socket": start}})
                run = jc.simulate(
                    rig, study.DENSE * period, save=study.SAVES + 1, state=state, throw=False
                )
                own = study.deviations(run, ideal)
                found.append((max(own[f"force {x} [N]"] for x in "xyz"), bool(run.succeeded)))
            forces, ended = [force for force, _ in found], sum(fine for _, fine in found)
            rows.append(
                {
                    "period [s]": period,
                    "socket": surface,
                    "least [N]": float(np.nanmin(forces)),
                    "median [N]": float(np.nanmedian(forces)),
                    "most [N]": float(np.nanmax(forces)),
                    "runs that reached their end": f"{ended} of {len(found)}",
                }
            )
    return rows


def main() -> None:
    options = arguments(__doc__)
    jax.config.update("jax_enable_compilation_cache", False)
    quick = options.quick
    report("First results of the 3RSR in a new process, CPU time", first_rows(), options)
    report(
        "A cycle of 1 s of the 3RSR with wear, CPU time",
        cost_rows(8 if quick else SAMPLES),
        options,
    )
    report(
        "Largest deviation of S1's force from the ideal one over the third cycle",
        peaks_rows((RATTLING,) if quick else (QUIET, 0.38, RATTLING), SEEDS[: 2 if quick else 5]),
        options,
    )
    if options.json is not None:
        told = {"about": about("benchmarks.claims.parallel_3rsr", options.json)}
        known = json.loads(options.json.read_text())
        options.json.write_text(json.dumps(told | known | told, indent=1) + "\n")


if __name__ == "__main__":
    main()
