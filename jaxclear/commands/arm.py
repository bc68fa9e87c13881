"""The study of the robot arm from one command: where its tip is off with and without play in its
reducers, what each loses at a reversal, what the plays do one by one and over their tolerances, and
which reducers are worth buying with less play.

Writes figures (PNG) and tables (CSV) into a folder and prints what it found.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas
from matplotlib.figure import Figure

import jaxclear as jc
from jaxclear import plot
from jaxclear.commands.study import StudyFolder, report_samples, report_warnings
from jaxclear.ground.numerics import safe_sqrt
from jaxclear.ground.table import as_table
from jaxclear.plot.canvas import MILLI, canvas, warned
from jaxclear.scenes.arm import (
    ARCMIN,
    CREEP,
    FRICTION,
    HINGES,
    JOINTS,
    LIFT,
    LIFTED,
    RATIO,
    REDUCERS,
    REST,
    SWING,
    TIP,
    JointPath,
    arm,
    pick_and_place,
)
from jaxclear.studies.store.batch import evaluate_all

# Plays from flank to flank [rad] of reducers in stock: standard and reduced, of the planetary
# reducers TP010 of Beckhoff's AG2400 (documentation, "maximum torsional backlash").
STANDARD, REDUCED = 3 * ARCMIN, 1 * ARCMIN
# So far a play scatters about what it should be, as a share of it; assumed.
SCATTER = 0.1
BOUGHT = 3
# Runs of the slopes, the choices and the sample come in as many, so that one program serves them.
CHUNK = 64
# Steps that resolve the last link on its flank; saving times are those of the way.
STEP = 1e-4
# Each rest's end [s], and what is done there.
RESTS = {
    "picked": REST,
    "lifted": 2 * REST + LIFT,
    "over its place": 3 * REST + LIFT + SWING,
    "placed": 4 * REST + 2 * LIFT + SWING,
}
# To and fro about the lifted arm [rad], as a triangle with round corners, twice [s]. The table has
# as many rows as that of pick and place, so that both share a program, and one where each way is
# half gone.
HALF_SWING, PERIOD, ROUND = 0.04, 1.8, 0.98
TABLE_STEP = PERIOD / 60


def simulated(rig: jc.Mechanism, path: JointPath | None = None, **options: Any) -> Any:
    """A run along a way, saved where its table stands."""
    times = (pick_and_place() if path is None else path).times
    step = jc.integrator.FixedStep(STEP)
    return jc.simulate(rig, times[-1], save=len(times), integrator=step, **options)


def ends(times: np.ndarray) -> np.ndarray:
    """Which saving times end the rests."""
    return np.array([int(np.argmin(np.abs(times - end))) for end in RESTS.values()])


def off(run: Any, other: Any) -> np.ndarray:
    """How far the tip is from that of another run [m]."""
    away = run.marker(TIP).position - other.marker(TIP).position
    return np.linalg.norm(np.asarray(away), axis=1)


def tip_error(without_play: Any) -> jc.response.FromFunction:
    """What play does to the tip where the arm rests: root mean square distance [m] from where the
    arm with the same elasticity and without play holds it."""
    at = ends(np.asarray(without_play.time))
    resting = without_play.marker(TIP).position[at]

    def error(run: Any) -> Any:
        away = run.marker(TIP).position[at] - resting
        return safe_sqrt(jnp.mean(jnp.sum(away * away, axis=-1)))

    return jc.response.FromFunction(error, "m", "motion")


def tip_problem(play: float, without_play: Any) -> jc.Problem:
    """The tip's error over the seven plays, all of one nominal size [rad]."""
    times = pick_and_place().times
    plays = {
        name: jc.Variable(
            lambda rig, name=name: rig.couplings[name].play.play, tolerance=SCATTER * REDUCED
        )
        for name in JOINTS
    }
    return jc.Problem(
        arm("play", play),
        {"tip error": tip_error(without_play)},
        plays,
        duration=times[-1],
        save=len(times),
        integrator=jc.integrator.FixedStep(STEP),
    )


def to_and_fro() -> JointPath:
    """All joints turn slowly by a little about the lifted arm, forwards and back."""
    times = TABLE_STEP * np.arange(len(pick_and_place().times))
    swing = np.arcsin(ROUND * -np.cos(2 * np.pi * times / PERIOD)) / np.arcsin(ROUND)
    return JointPath(times, np.array(LIFTED) + HALF_SWING * swing[:, None])


def lost_motion(run: Any, play: float) -> pandas.DataFrame:
    """What each joint loses where it turns round (the reversal value of ISO 230-2:2014, at the
    middle of the way): joint less motor, forwards less back. Beside it the closed form: twice the
    twist by what the joint rubs with, and the play where no weight presses one flank."""
    times = np.asarray(run.time)
    up, down = (int(np.argmin(np.abs(times - PERIOD * (1 + x)))) for x in (0.25, 0.75))
    rows = []
    for name, hinge in zip(JOINTS, HINGES, strict=True):
        behind = twist(run, name)
        speed = float(run.speed(name)[up])
        rubbing = FRICTION * np.tanh(speed / CREEP) + hinge.damping * speed
        torques = [float(run.transmitted(name)[k]) for k in (up, down)]
        crossed = torques[0] * torques[1] < 0
        stretched = abs(torques[0] - torques[1]) / REDUCERS[name].stiffness
        rows.append(
            {
                "joint": name,
                "rubs with [N m]": rubbing,
                "carries [N m]": 0.5 * sum(torques),
                "loses [arcmin]": abs(behind[up] - behind[down]) / ARCMIN,
                "2 t/k, and the play if crossed [arcmin]": (stretched + crossed * play) / ARCMIN,
            }
        )
    return as_table(rows)


def twist(run: Any, name: str) -> np.ndarray:
    """How far a joint is ahead of its motor [rad]."""
    return np.asarray(run.coordinate(name)) - np.asarray(run.coordinate(f"{name}.motor")) / RATIO


def slopes(problem: jc.Problem) -> pandas.DataFrame:
    """The tip's error by each play [mm/arcmin], by central differences over a tenth of it, two runs
    a play in one batch, and its share of the error: slope times play over the sum."""
    nominal = np.asarray(problem.nominal())
    moved = np.diag(SCATTER * nominal)
    values = np.concatenate([nominal + moved, nominal - moved])
    runs = evaluate_all(problem, jnp.asarray(np.resize(values, (CHUNK, len(nominal)))))
    more, less = np.split(np.asarray(runs.responses["tip error"])[: len(values)], 2)
    slope = (more - less) / (2 * SCATTER * nominal)
    parts = slope * nominal
    return as_table(
        {
            "joint": list(JOINTS),
            "slope [mm/arcmin]": MILLI * ARCMIN * slope,
            "part of the error [mm]": MILLI * parts,
            "share [1]": parts / parts.sum(),
        }
    )


def every_choice(problem: jc.Problem) -> pandas.DataFrame:
    """The tip's error [mm] of each choice of reducers to buy with reduced play, the others
    standard, best first."""
    grid = jc.sweep(problem, dict.fromkeys(JOINTS, (STANDARD, REDUCED)))
    error = grid.responses["tip error"]
    rows = [
        {"bought": sum(x), "reduced play in": named(x), "tip error [mm]": MILLI * error[x]}
        for x in np.ndindex(error.shape)
    ]
    return as_table(rows).sort_values("tip error [mm]", ignore_index=True)


def named(bought: Sequence[Any]) -> str:
    """The numbers of the joints whose reducers are bought."""
    return " ".join(name[-1] for name, chosen in zip(JOINTS, bought, strict=True) if chosen)


def price(nominal: Mapping[str, Any], tolerance: Mapping[str, Any]) -> Any:
    """How many reducers have reduced play."""
    return sum((STANDARD - nominal[name]) / (STANDARD - REDUCED) for name in JOINTS)


def designed(problem: jc.Problem, at_most: float, **options: Any) -> Any:
    """The fewest reducers of reduced play with which the mean error keeps to a limit [m]."""
    return jc.design(
        problem,
        price,
        jc.limit.MeanAndDeviation("tip error", at_most=at_most, deviations=0),
        nominal=dict.fromkeys(JOINTS, jc.catalogue.Sizes((REDUCED, STANDARD))),
        **options,
    )


def rests(runs: Mapping[str, Any], commanded: Any) -> pandas.DataFrame:
    """How far each run's tip is from the commanded place [mm] where the arm rests, and at most on
    its way."""
    rows = []
    for name, run in runs.items():
        away = MILLI * off(run, commanded)
        at = dict(zip(RESTS, away[ends(np.asarray(run.time))], strict=True))
        rows.append(
            {"reducers": name}
            | {f"{rest} [mm]": one for rest, one in at.items()}
            | {"largest [mm]": away.max()}
        )
    return as_table(rows)


def error_figure(runs: Mapping[str, Any], commanded: Any) -> Figure:
    """Distance of the tip from the commanded place over time; shaded where the arm rests."""
    figure, axes = canvas(2, 1, (8.0, 6.0), sharex=True)
    for end in RESTS.values():
        for axis in axes:
            axis.axvspan(end - REST, end, color="C2", alpha=0.12, lw=0)
    plain = runs["elastic"]
    for k, (name, run) in enumerate(runs.items()):
        axes[0].plot(run.time, MILLI * off(run, commanded), color=f"C{k}", lw=1.0, label=name)
        if run is not plain and name != "rigid":
            axes[1].plot(run.time, MILLI * off(run, plain), color=f"C{k}", lw=1.0, label=name)
    axes[0].set_ylabel("tip beside the\ncommanded place [mm]")
    axes[1].set_ylabel("tip beside that of\nelastic reducers [mm]")
    axes[1].set_xlabel("time [s]")
    names = axes[0].get_legend_handles_labels()
    figure.legend(*names, loc="outside lower center", ncols=4, fontsize=8, title="reducers")
    axes[0].set_title("A part is picked and placed; shaded: the arm rests")
    return warned(figure, runs)


def loop_figure(run: Any, table: pandas.DataFrame) -> Figure:
    """Joint less motor over each joint's way, forwards and back."""
    figure, axes = canvas(2, 4, (12.0, 5.5), squeeze=False)
    second = np.asarray(run.time) >= PERIOD
    for axis, name, loss in zip(axes.flat, JOINTS, table["loses [arcmin]"], strict=False):
        angle = np.asarray(run.coordinate(name)) - LIFTED[JOINTS.index(name)]
        axis.plot(angle[second] / ARCMIN, twist(run, name)[second] / ARCMIN, color="C0", lw=1.0)
        axis.set_title(f"{name}: loses {loss:.2f} arcmin", fontsize=9)
        axis.set_xlabel("joint about the lifted arm [arcmin]", fontsize=8)
        axis.set_ylabel("joint less motor [arcmin]", fontsize=8)
    axes.flat[-1].remove()
    return warned(figure, {"": run})


def budget_figure(table: pandas.DataFrame) -> Figure:
    """The tip's error by each play."""
    figure, axes = canvas()
    axes.bar(table["joint"], table["slope [mm/arcmin]"], color="C0")
    axes.axhline(0.0, color="k", lw=0.6)
    axes.set_ylabel("tip error by the play of a reducer [mm/arcmin]")
    axes.set_title("Slopes by all seven plays")
    return figure


def choices_figure(table: pandas.DataFrame, chosen: str) -> Figure:
    """The error of every choice over how many reducers it buys; the design's is marked."""
    figure, axes = canvas()
    axes.plot(table["bought"], table["tip error [mm]"], "o", color="C0", ms=4, alpha=0.6)
    best = table.groupby("bought").first()
    axes.plot(best.index, best["tip error [mm]"], "-", color="C0", lw=0.8, label="best of each")
    row = table[table["reduced play in"] == chosen].iloc[0]
    label = f"the design: joints {chosen}"
    axes.plot(row["bought"], row["tip error [mm]"], "s", color="C1", ms=9, mfc="none", label=label)
    axes.set_xlabel("reducers of reduced play")
    axes.set_ylabel("tip error where the arm rests [mm]")
    axes.legend(fontsize=8)
    return figure


def study(folder: Path, samples: int = CHUNK, show: bool = True) -> None:
    """Runs the study of the arm and writes its tables and figures.

    Args:
        folder: for the files.
        samples: of the Monte Carlo.
        show: whether progress bars are shown.
    """
    files = StudyFolder(folder)
    commanded = simulated(arm(driven=True), verify=False)
    runs = {
        "rigid": simulated(arm()),
        "elastic": simulated(arm("play", 0.0)),
        "1 arcmin of play": simulated(arm("play", REDUCED)),
        "3 arcmin of play": simulated(arm("play", STANDARD)),
    }
    loop = simulated(arm("play", REDUCED, path=to_and_fro()), to_and_fro())
    report_warnings(runs | {"to and fro": loop})
    problem = tip_problem(STANDARD, runs["elastic"])
    tables = {
        "rests": rests(runs, commanded),
        "lost_motion": lost_motion(loop, REDUCED),
        "slopes": slopes(problem),
        "choices": every_choice(problem),
    }
    sample = jc.monte_carlo(problem, samples, progress_bar=show)
    three = tables["choices"].query(f"bought == {BOUGHT}").iloc[0]
    # Half of what lies between the best three and the best two.
    two = tables["choices"].query(f"bought == {BOUGHT - 1}").iloc[0]
    limit = 0.5 * (three["tip error [mm]"] + two["tip error [mm]"]) / MILLI
    design = designed(problem, limit, progress_bar=show)
    chosen = named([design.nominal[name] < 2 * REDUCED for name in JOINTS])
    files.write_tables(**tables, samples=sample.table(), design=design.table())
    for name, table in tables.items():
        print(f"{name.replace('_', ' ')}\n{table.head(10)}\n")
    report_samples(sample)
    errors = MILLI * np.asarray(sample.responses["tip error"])
    print(f"Tip error {errors.mean():.4g} mm, standard deviation {errors.std():.2g} mm.")
    plays = {name: f"{float(play) / ARCMIN:.3g}" for name, play in design.nominal.items()}
    print(f"{design.sentence()} Plays [arcmin]: {', '.join(map(' '.join, plays.items()))}.")
    print(f"Reduced play in joints {chosen}; by enumeration {three['reduced play in']}.")
    files.write_figures(
        tip_error=error_figure(runs, commanded),
        lost_motion=loop_figure(loop, tables["lost_motion"]),
        slopes=budget_figure(tables["slopes"]),
        monte_carlo=plot.monte_carlo(sample),
        choices=choices_figure(tables["choices"], chosen),
    )
    print(files.sentence())
