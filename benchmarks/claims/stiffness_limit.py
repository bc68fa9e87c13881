"""One mechanism, both formulations: as contact stiffens, the compliant slider-crank becomes the
nonsmooth one.

The slider-crank of `peers.rig` at a moderate speed, its law one whose restitution does not depend
on stiffness. The first impact comes at the same instant; it then takes a time in proportion to
K^(-2/5) (Hertz), by which all that follows is late. Later impacts multiply differences until the
paths have nothing in common. Moreau-Jean's own error goes with the step.

Then the four-bar (planar, without friction) over its first impacts: worn volume and energy lost, as
means over a few nearly equal runs. Steel takes 0.75 ms for the first impact, in which the journal
slides on and the normal turns; stiffer contacts strike twice instead, as rigid ones do.
"""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, report, sign
from benchmarks.peers.rig import (
    CLEARANCE,
    CRANK,
    RADIUS,
    RESTITUTION,
    ROD,
    ROD_INERTIA,
    ROD_MASS,
    SLIDER_MASS,
)
from jaxclear.scenes.four_bar import four_bar

SPEED = 100.0
STIFFNESSES = tuple(10.0**k for k in range(6, 13))
# Saving times lie this far apart [s]: instants are known to that.
GRID, DURATION = 1e-6, 12e-3
# Step of Moreau and Jean's scheme beside compliant contact; its reference when it is refined.
FINE, FINEST = 1e-7, 2.5e-8
IMPACTS = 3
RTOL = 1e-10
# Four-bar: span [s] and saving times, members whose clearances [m] differ by this share, tolerance
# of compliant runs.
SPAN, SAVES, MEMBERS, SPREAD, FOUR_BAR_CLEARANCE = 0.1, 401, 8, 5e-4, 0.2e-3
FOUR_BAR_STIFFNESSES, FOUR_BAR_STEPS, FOUR_BAR_RTOL = (
    tuple(10.0**k for k in range(9, 15)),
    (1e-4, 1e-5, 1e-6),
    1e-8,
)


class Motion(NamedTuple):
    """What is compared: saving times [s], place of the slider [m], offset of the journal over the
    clearance.
    """

    times: np.ndarray
    place: np.ndarray
    eccentricity: np.ndarray


def slider_crank(law: Any) -> jc.Mechanism:
    """Crank, rod and slider; journal on the slider."""
    return jc.Mechanism(
        {
            "crank": jc.Body(1.0, 1e-3),
            "rod": jc.Body(ROD_MASS, ROD_INERTIA, (ROD / 2, 0.0)),
            "slider": jc.Body(SLIDER_MASS, 1e-4),
        },
        {
            "O": jc.Connection(
                jc.joint.Revolute(drive=jc.drive.ConstantSpeed(SPEED)), "ground", "crank"
            ),
            "A": jc.Connection(jc.joint.Revolute(), "crank", "rod", at=(CRANK, 0.0)),
            "B": jc.Connection(
                jc.clearance.PlanarJournalBearing(law, bearing_radius=RADIUS, clearance=CLEARANCE),
                jc.Marker("rod", (ROD, 0.0)),
                "slider",
            ),
            "G": jc.Connection(jc.joint.Prismatic(), "ground", "slider", axis="x"),
        },
        start={"G": CRANK + ROD},
    )


def path(law: Any, integrator: Any, grid: float) -> Motion:
    """A run from the concentric start."""
    run = jc.simulate(
        slider_crank(law), DURATION, save=round(DURATION / grid) + 1, integrator=integrator
    )
    offset = np.asarray(run.contact("B").offset)[:, :2]
    return Motion(
        np.asarray(run.time), np.asarray(run.coordinate("G")), np.hypot(*offset.T) / CLEARANCE
    )


def rigid(step: float, grid: float) -> Motion:
    return path(jc.contact.Rigid(restitution=RESTITUTION), jc.integrator.MoreauJean(step), grid)


def compliant(stiffness: float, grid: float) -> Motion:
    law = jc.contact.CarvalhoMartins(stiffness=stiffness, restitution=RESTITUTION)
    return path(law, jc.integrator.Adaptive(rtol=RTOL, atol=RTOL * 1e-2), grid)


def impacts(found: Motion) -> list[float]:
    """Instants of the first impacts [s]: where the journal is farthest out."""
    e = found.eccentricity
    tops = np.flatnonzero((e[1:-1] >= e[:-2]) & (e[1:-1] > e[2:]) & (e[1:-1] > 0.98)) + 1
    return [float(found.times[k]) for k in tops[:IMPACTS]] + [math.nan] * (IMPACTS - len(tops))


def differences(found: Motion, exact: Motion) -> dict[str, float]:
    """Of the slider's place, at most until the second impact and over the whole run, and of the
    instants of impacts.
    """
    off = np.abs(found.place - exact.place)
    early = off[exact.times <= impacts(exact)[1]]
    row = {"slider until impact 2 [m]": float(early.max()), "slider [m]": float(off.max())}
    return row | {
        f"impact {k + 1} [s]": abs(a - b)
        for k, (a, b) in enumerate(zip(impacts(found), impacts(exact), strict=True))
    }


def with_rates(rows: list[dict[str, Any]], over: str) -> list[dict[str, Any]]:
    """Slopes of the logarithms from one row to the next."""
    out: list[dict[str, Any]] = []
    for before, row in zip([None, *rows], rows, strict=False):
        rates = {}
        for name in ("slider until impact 2 [m]", "slider [m]", "impact 2 [s]"):
            known = before is not None and min(row[name], before[name]) > 0
            slope = (
                math.log(row[name] / before[name]) / math.log(row[over] / before[over])
                if known
                else math.nan
            )
            rates[f"rate of {name.split(' [')[0]}"] = slope
        out.append(row | rates)
    return out


def limit_rows(
    stiffnesses: tuple[float, ...], grid: float, step: float = FINE
) -> list[dict[str, Any]]:
    """Compliant contact against rigid contact."""
    exact = rigid(step, grid)
    rows = [
        {"K [N/m^1.5]": stiffness} | differences(compliant(stiffness, grid), exact)
        for stiffness in stiffnesses
    ]
    return with_rates(rows, "K [N/m^1.5]")


def refinement_rows(steps: tuple[float, ...], grid: float, finest: float) -> list[dict[str, Any]]:
    """Rigid contact against itself at a fine step."""
    exact = rigid(finest, grid)
    return with_rates(
        [{"step [s]": step} | differences(rigid(step, grid), exact) for step in steps], "step [s]"
    )


def four_bar_means(law: Any, integrator: Any) -> dict[str, float]:
    """Worn volume and energy lost by contact at the end, and the standard error of the former."""
    scene = four_bar("planar", friction=False)
    where = lambda rig: rig.connections["B"].joint
    volumes, losses = [], []
    for share in SPREAD * np.linspace(-1, 1, MEMBERS):
        clearance = jnp.asarray(FOUR_BAR_CLEARANCE * (1 + share))
        rig = eqx.tree_at(
            lambda rig: (where(rig).contact, where(rig).clearance), scene, (law, clearance)
        )
        run = jc.simulate(rig, SPAN, save=SAVES, integrator=integrator, balance=True)
        volumes.append(float(run.worn_volume("B", "bearing")[-1]))
        losses.append(float(run.energy_balance().contact_loss[-1]))
    doubt = float(np.std(volumes, ddof=1) / math.sqrt(MEMBERS))
    return {
        "worn volume [m^3]": float(np.mean(volumes)),
        "its standard error [m^3]": doubt,
        "lost [J]": float(np.mean(losses)),
    }


def four_bar_rows(stiffnesses: tuple[float, ...], steps: tuple[float, ...]) -> list[dict[str, Any]]:
    """Compliant contact, stiffer and stiffer, then rigid contact, finer and finer."""
    adaptive = jc.integrator.Adaptive(rtol=FOUR_BAR_RTOL, atol=FOUR_BAR_RTOL * 1e-3)
    compliant = {
        f"K = {k:g} N/m^1.5": (
            jc.contact.CarvalhoMartins(stiffness=k, restitution=RESTITUTION),
            adaptive,
        )
        for k in stiffnesses
    }
    rigid = {
        f"rigid, {h:g} s": (jc.contact.Rigid(restitution=RESTITUTION), jc.integrator.MoreauJean(h))
        for h in steps
    }
    return [{"contact": name} | four_bar_means(*pair) for name, pair in (compliant | rigid).items()]


def main() -> None:
    options = arguments(__doc__)
    stiffnesses = STIFFNESSES[::2] if options.quick else STIFFNESSES
    grid = 4 * GRID if options.quick else GRID
    report(
        "stiffness limit: compliant against rigid contact", limit_rows(stiffnesses, grid), options
    )
    steps = tuple(grid / 2**k for k in range(4 if options.quick else 5))
    report(
        "stiffness limit: step of Moreau and Jean", refinement_rows(steps, grid, FINEST), options
    )

    some = 2 if options.quick else 1
    rows = four_bar_rows(FOUR_BAR_STIFFNESSES[::some], FOUR_BAR_STEPS[::-some][::-1])
    report(
        f"stiffness limit: the four-bar over {SPAN:g} s, means over {MEMBERS} runs", rows, options
    )
    sign("benchmarks.claims.stiffness_limit", options.json)


if __name__ == "__main__":
    main()
