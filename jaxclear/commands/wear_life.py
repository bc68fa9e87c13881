"""The wear of a life from one command: a four-bar whose bearing wears as lubricated steel does, its
settled cycle, depth and forces over a million cycles, the groove that it digs.

Writes figures (PNG), tables (CSV) and a store into a folder, from which an interrupted life
goes on, and prints what it found.
"""

import math
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import matplotlib
import numpy as np
from matplotlib.figure import Figure

import jaxclear as jc
from jaxclear import plot
from jaxclear.commands.study import StudyFolder, report_warnings
from jaxclear.plot.canvas import MICRO, as_warnings, canvas, captioned, shades
from jaxclear.scenes.four_bar import four_bar
from jaxclear.studies.life.result import WearLife

# Assumed: steel in oil. The paper's coefficient is a thousand times larger, to see wear in seconds.
WEAR_COEFFICIENT = 2e-5
CRANK_SPEED = 10.0
# Steps [s] that resolve the impacts on worn surfaces too; saves a turn.
STEP, SAVES = 6e-6, 2001
JOINT, SURFACE = "B", "bearing"
# Lives at which the groove is drawn, as shares of the whole.
SHARES = (0.1, 0.25, 0.5, 0.75, 1.0)
# Depth of which a life is told, as a share of the largest that was reached.
DEPTH_SHARE = 0.5


def life_problem() -> jc.Problem:
    """A turn of the four-bar: forces in the worn joint, and how far the coupler's centre of mass is
    from where it is with an ideal joint."""
    period = 2 * math.pi / CRANK_SPEED
    ideal = jc.simulate(four_bar("ideal", crank_speed=CRANK_SPEED), period, save=SAVES)
    rig = eqx.tree_at(
        lambda rig: rig.connections[JOINT].joint.bearing_wear.law.wear_coefficient,
        four_bar("planar", crank_speed=CRANK_SPEED),
        jnp.asarray(WEAR_COEFFICIENT),
    )
    responses = {
        "mean force": jc.response.MeanContactForce(JOINT),
        "peak force": jc.response.PeakContactForce(JOINT),
        "position error": jc.response.PositionError("coupler", ideal.body("coupler").com),
    }
    integrator = jc.integrator.FixedStep(STEP)
    return jc.Problem(rig, responses, {}, duration=period, save=SAVES, integrator=integrator)


def groove_figure(life: WearLife) -> Figure:
    """Depth around the bearing after shares of the life."""
    figure, axes = canvas()
    for share, colour in zip(SHARES, shades(len(SHARES))[::-1], strict=True):
        cycles = share * life.cycles[-1]
        depth = np.asarray(life.worn(cycles)[JOINT][SURFACE]).mean(axis=1)
        wear_map = life.problem.mechanism.connections[JOINT].joint.maps()[SURFACE][0]
        angle = np.rad2deg(np.asarray(wear_map.angles()))
        axes.plot(angle, MICRO * depth, color=colour, lw=1.2, label=f"{cycles:.3g} cycles")
    axes.xaxis.set_major_locator(matplotlib.ticker.MultipleLocator(60))
    axes.set_xlabel("angle around the bearing, from the coupler's axis [°]")
    axes.set_ylabel("depth [µm]")
    axes.legend(fontsize=8)
    axes.set_title("The groove in the bearing")
    return captioned(figure, as_warnings(life.warnings))


def study(folder: Path, cycles: float = 1e6, tolerance: float = 1e-2, show: bool = True) -> None:
    """Runs the study of the wear life and writes its tables and figures.

    Args:
        folder: for the files.
        cycles: of the life.
        tolerance: relative accuracy of the depth [1].
        show: whether progress bars are shown.
    """
    files = StudyFolder(folder)
    problem = life_problem()
    settled = jc.steady_cycle(problem)
    print(f"{settled}\n", flush=True)
    life = jc.wear_life(
        problem, cycles=cycles, accuracy=tolerance, store=folder / "store", progress_bar=show
    )
    print(life.sentence())
    report_warnings({"life": life})
    files.write_tables(settled=settled.table(), life=life.table())
    print(f"\n{life.table()}\n")
    print(life.until("depth", DEPTH_SHARE * float(life.over_life("depth")[-1])))
    files.write_figures(life=plot.wear_life(life), groove=groove_figure(life))
    print(files.sentence("a store"))
