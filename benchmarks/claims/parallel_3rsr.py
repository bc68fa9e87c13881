"""What a worn socket of the 3RSR does to the peaks of force: read smoothly, with the stiffness of
the radius as made or as worn, and as one radius for each cell.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import run_tables
from jaxclear.commands import parallel_3rsr as study
from jaxclear.components.clearance import AbstractClearance, BallSocket
from jaxclear.ground.numerics import direction_angle
from jaxclear.ground import sparse as sp
from jaxclear.scenes.parallel_3rsr import QUIET, RATTLING, parallel_3rsr

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


def peaks_rows(options):
    """Largest deviation of the force from the ideal one over the third cycle, with the surface new,
    worn and smooth (as stiff as made, or as the worn radius), and worn with a radius for each cell:
    least and most over the starts."""
    periods = (RATTLING,) if options.quick else (QUIET, 0.38, RATTLING)
    seeds = SEEDS[: 2 if options.quick else None]
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


TITLE = "Largest deviation of S1's force from the ideal one over the third cycle"

if __name__ == "__main__":
    run_tables({TITLE: peaks_rows})
