"""No text of a figure lies upon another or leaves it, whatever the runs: depths of 1e-12 m, forces
of 1e6 N, 3 and 3000 samples, long names.

Every function of `jaxclear.plot` that draws has its cases here. Lives, designs and advice, which
take long, are made up: a figure reads the same of them."""

import functools
from types import SimpleNamespace
from unittest import mock

import equinox as eqx
import matplotlib.figure
import numpy as np
import pandas
import pytest

import jaxclear as jc
from benchmarks.figures_text import colliding
from jaxclear import plot
from jaxclear.components.joint import Prismatic, Revolute
from jaxclear.results.pointing_error import PointingError
from jaxclear.results.trajectory import Trajectory
from jaxclear.scenes.slider_crank import bearing
from jaxclear.statics.positions import Positions
from jaxclear.studies.advice import Advice
from jaxclear.studies.design.result import Design
from jaxclear.studies.life.result import WearLife
from jaxclear.studies.life.steady_cycle import SteadyCycle
from jaxclear.studies.life.wear_life import WearLifeSample
from jaxclear.studies.sensitivity.derivative import Derivative, Estimate, Sensitivity
from tests.plot.identified import identified

CRANK, ROD, SLIDER = (
    f"{one} of the second stage of the pump" for one in ("crank", "rod", "slider")
)
JOINT, PIN, GUIDE = (
    f"{one} of the second stage" for one in ("rod's bearing", "crank pin", "guide")
)
FORCE, SHIFT = f"largest normal force in the {JOINT} of the pump", f"largest way of the {SLIDER}"
CLEARANCE, SPEED = f"radial clearance of the {JOINT} of the pump", f"angular speed of the {CRANK}"
UNITS = {FORCE: "N", SHIFT: "m"}
PERIOD = 1e-3
LONG = "Something that the run warns of, in a sentence as long as such sentences are, " * 2


@functools.cache
def run():
    """Heavy bodies under long names, whose wear is scaled to 1e-12 m."""
    heavy = jc.Mechanism(
        {
            CRANK: jc.Body(9e2, 0.3, (0.025, 0.0)),
            ROD: jc.Body(6e2, 0.75, (0.06, 0.0)),
            SLIDER: jc.Body(4e2, 0.3),
        },
        {
            "O": jc.Connection(Revolute(drive=jc.drive.ConstantSpeed(400.0)), "ground", CRANK),
            PIN: jc.Connection(Revolute(), CRANK, ROD, at=(0.05, 0.0)),
            JOINT: jc.Connection(bearing(2e-4, wear=True), ROD, SLIDER, at=(0.12, 0.0)),
            GUIDE: jc.Connection(
                Prismatic(), jc.Marker("ground", axis="x"), jc.Marker(SLIDER, axis="x")
            ),
        },
        guess={GUIDE: 0.17},
    )
    found = jc.simulate(heavy, 4e-3, save=41, integrator=jc.integrator.FixedStep(1e-5))
    depth = found.worn[JOINT]["bearing"]
    return eqx.tree_at(lambda r: r.worn[JOINT]["bearing"], found, depth * 1e-12 / depth.max())


def tilting():
    """A journal with two ends, of a run that is made up."""
    joint = jc.scenes.four_bar("spatial").connections["B"].joint
    turn = np.linspace(0.0, 6.0, 50)[:, None]
    offset = 0.9 * float(joint.clearance) * np.hstack([np.cos(turn), np.sin(turn), 0 * turn])
    axis = np.tile([1e-6, 0.0, 1.0], (50, 1))
    told = SimpleNamespace(connections={JOINT: SimpleNamespace(joint=joint)})
    history = SimpleNamespace(offset=offset, axis=axis)
    return mock.Mock(
        spec=Trajectory,
        mechanism=told,
        contact=lambda _: history,
        history=SimpleNamespace(check_single=lambda: None),
        warnings=(),
        notes=(),
        time=turn[:, 0],
    )


def stack(**sizes):
    clearance, speed = sizes.values()
    return {FORCE: 1e9 * clearance + 2e8 * speed, SHIFT: 1e-9 * clearance * (1 + speed)}


@functools.cache
def problem(function=stack):
    sizes = {
        CLEARANCE: jc.Dimension(1e-3, jc.distribution.Normal(1e-5), unit="m"),
        SPEED: jc.Dimension(1e-3, jc.distribution.Uniform(2e-5), unit="rad/s"),
    }
    return jc.FunctionProblem(function, sizes, units=UNITS)


@functools.cache
def sample(count):
    return jc.monte_carlo(problem(), count)


def narrow(count):
    """Responses that hardly differ, at 3000.0012 of their unit."""
    own = sample(count)
    told = {FORCE: 3e3 + 1e-7 * own.responses[FORCE], SHIFT: 2e-3 + own.responses[SHIFT]}
    return eqx.tree_at(lambda s: s.responses, own, told)


def derivatives(verdict):
    """Answers of three methods, one of which refused."""
    told = {
        "pathwise": Estimate(1.0023e9, 2e6),
        "regression with a surface": Estimate(1.004e9, 3e7),
        "differences": Estimate(np.nan, np.nan, "too few samples."),
    }
    own = {
        (response, variable): Derivative(
            response, variable, 1.0023e9, 2e6, "pathwise", verdict, True, told
        )
        for response in UNITS
        for variable in (CLEARANCE, SPEED)
    }
    return Sensitivity(own, sample(3))


def life(sizes=1e-12, warnings=(LONG,)):
    """Two surfaces over 1e9 cycles."""
    cycles = np.linspace(0.0, 1e9, 5)
    stage = SimpleNamespace(
        settled=SimpleNamespace(responses=lambda: {FORCE: (1e6, 1e4), SHIFT: (1e-12, 1e-14)})
    )
    values = {FORCE: 1e6, SHIFT: 1e-12}
    return mock.Mock(
        spec=WearLife,
        problem=problem(),
        cycles=cycles,
        surfaces=((JOINT, "bearing"), (JOINT, "journal")),
        errors=np.full(5, 0.0123),
        errors_of_volume=np.full(5, 1e-3),
        over_life=lambda name, at=cycles: values.get(name, sizes) * (1e-3 + at / 1e9),
        simulated=37,
        ended="the journal's wall is worn through.",
        warnings=warnings,
        stages=[stage] * 5,
        is_affected=lambda _: True,
    )


def lives():
    told = (
        "2 lives, 0 ended early, 2 with warnings. Depths are 3e-12 to 1.2e-05 m, known to 1.2 % or "
    )
    told += "better."
    return mock.Mock(spec=WearLifeSample, lives=(life(), life(3e-12)), sentence=lambda: told)


def settled():
    table = pandas.DataFrame(
        {
            "cycle": [1, 2, 3],
            "apart": [1e-2, 1e-5, 1e-12],
            "taken": [False, False, True],
            f"{FORCE} [N]": [1.001e6, 1.002e6, 1.0021e6],
            f"{SHIFT} [m]": [1e-12, 2e-12, 2.00001e-12],
        }
    )
    told = f'Periodic after 3 cycles of 0.125664 s: "{JOINT}" is 1e-12 from where it was.'
    return mock.Mock(
        spec=SteadyCycle, table=lambda: table, problem=problem(), tolerance=1e-9, warnings=(LONG,) *
        9, sentence=lambda: told,
    )  # fmt: skip


def pointing():
    """Errors of 1e-12, to which two joints contribute."""
    time = np.linspace(0.0, 1e-3, 50)
    twist = 1e-12 * np.sin(7e3 * time)[:, None] * np.arange(1, 7)
    names = (JOINT, PIN)
    columns = ("rms pointing [rad]", "rms position [m]")
    shares = ("share of pointing [1]", "share of position [1]")
    table = pandas.DataFrame(
        {name: [1e-12, 2e-12, 3e-12, 3e-12] for name in columns}
        | {name: [-0.123456, 1.123456, 1.0, np.nan] for name in shares},
        index=[*names, "model", "exact"],
    )
    return mock.Mock(
        spec=PointingError,
        time=time,
        names=names,
        contributions=dict.fromkeys(names, twist),
        model=twist,
        pointing_angle=np.abs(twist[:, 3]),
        position_error=np.abs(twist[:, 0]),
        budget=lambda: table,
        tip=SLIDER,
        base=CRANK,
        warnings=(LONG,),
    )


def standing():
    """Places of bodies 1e3 m apart, and seats that differ by 1e-12 m."""
    at = np.linspace(0.0, 1.0, 7)[:, None]
    seat = np.hstack([2e-4 + 1e-12 * at, 1e-12 * at**2, 0 * at])
    bodies = dict.fromkeys((CRANK, ROD, SLIDER))
    return mock.Mock(
        spec=Positions,
        scene=SimpleNamespace(mechanism=SimpleNamespace(bodies=bodies)),
        body=lambda _: SimpleNamespace(com=1e3 * np.hstack([np.cos(at), np.sin(at), 0 * at])),
        seats={JOINT: None, PIN: None},
        offset=lambda _: seat,
        is_solved=at[:, 0] > 0,
    )


def designed(cost=0.0123):
    limit = jc.limit.WorstCase(FORCE, at_most=1.2345e6)
    freedom = SimpleNamespace(names=(CLEARANCE, SPEED), usual=np.array([1e-12, 2e-12]))
    check = SimpleNamespace(excess_errors=np.array([0.01, 0.02]))
    history = pandas.DataFrame(
        {"runs": [64, 1280, 123456], "cost": [1e6, 1.0002e6, 1.0001e6], "largest excess": [1, 0, 0]}
    )
    said = f"It does not hold: {limit.words()} is kept in 98 % of the machines only. " * 2
    return mock.Mock(
        spec=Design,
        problem=problem(),
        question=SimpleNamespace(freedom=freedom),
        limits=(limit, limit),
        nominal={CLEARANCE: 1.00002e-3, SPEED: 1e-3},
        tolerances={CLEARANCE: 1.1e-12, SPEED: 3e-12},
        excess=np.array([0.02, -0.4]),
        allowed_excess=0.01,
        round=SimpleNamespace(check=check),
        history=lambda: history,
        sentence=lambda: f"Cost {1e6 * cost:.6g}. {said}",
        holds=cost > 1,
        cost=1e6 * cost,
        unit=lambda _: "N",
    )


def advised():
    """Settings that part, fail, and err by 1e52."""
    methods = np.repeat(["ExplicitAdaptive", "ImplicitStep", "the problem's own"], [5, 5, 1])
    errors = [1e52, 3.0, 1e-2, 1e-5, 1e-9, np.nan, 0.3, 0.1, 3e-3, 2e-3, 0.5]
    table = pandas.DataFrame(
        {
            "method": methods,
            "work": [10**k for k in (2, 3, 4, 5, 6, 2, 3, 4, 5, 6, 4)],
            "error": errors,
            "left out by the model": [np.nan] * 11,
            "recommended": [False] * 3 + [True] + [False] * 7,
        }
    )
    return mock.Mock(
        spec=Advice,
        table=lambda: table,
        accuracy=1e-4,
        wanted=SimpleNamespace(means=True),
        recommended=jc.integrator.Adaptive(rtol=1.2345e-9, atol=1.2345e-12),
        warnings=lambda: [LONG],
    )


SUNK = jc.limit_state.Above(FORCE, 1.23e6)
VERDICT = "From pathwise, confirmed by regression with a surface. Not confirmed by differences. "


def drawn():
    rig = jc.scenes.slider_crank()
    lines = {
        "B": jc.fit("20 H7/f7"),
        f"hole of the {ROD}": jc.tolerance.Position(5e-5, marker="B.parent", at_mmc="B"),
        f"hole of the {CRANK}": jc.tolerance.Position(1e-4, marker="A.parent"),
    }
    return jc.Drawing(rig, lines)


WIDE = np.linspace(1e-3, 1.1e-3, 5)


def largest():
    limit = jc.limit.Quantile(FORCE, at_most=1e6, share=0.95)
    return plot.largest(jc.largest(problem(), CLEARANCE, limit, (1e-4, 3e-4)))


def corrected():
    found = jc.corrected_statistics(jc.surface(problem()), 8, limits={"sunk": SUNK})
    return plot.corrected_statistics(found)


def remaining():
    records = {0: identified(problem()), 1e6: identified(problem())}
    return plot.remaining_life(jc.remaining_life(records, CLEARANCE, 1.0))


def displaced():
    runs = {f"clearance {k} of {JOINT}": run() for k in range(5)}
    return plot.displacement(runs, run(), SLIDER)


def cheaper():
    other = problem(lambda **sizes: stack(**sizes))
    return plot.multi_fidelity(jc.multi_fidelity(problem(), other, 256))


def swept(**over):
    names = {"clearance": CLEARANCE, "speed": SPEED}
    return plot.sweep(jc.sweep(problem(), {names[name]: own for name, own in over.items()}))


CASES = {
    "angular_velocity": [lambda: plot.angular_velocity(run(), run(), ROD, f"with a loose {JOINT}")],
    "bifurcation": [lambda: plot.bifurcation({2e-4: run(), 2.1e-4: run()}, SLIDER, period=PERIOD)],
    "corrected_statistics": [corrected],
    "design": [lambda: plot.design(designed())],
    "largest": [largest],
    "pareto_front": [lambda: plot.pareto_front([designed(), designed(2.0)])],
    "displacement": [displaced],
    "drawing": [lambda: plot.drawing(drawn())],
    "error_budget": [lambda: plot.error_budget(sample(3000))],
    "hysteresis": [lambda: plot.hysteresis(run(), JOINT)],
    "journal_ends": [lambda: plot.journal_ends(tilting(), JOINT)],
    "journal_orbit": [lambda: plot.journal_orbit(run(), JOINT)],
    "modes": [lambda: plot.modes(run())],
    "monte_carlo": [
        lambda: plot.monte_carlo(sample(3)),
        lambda: plot.monte_carlo(sample(3000)),
        lambda: plot.monte_carlo(narrow(3)),
        lambda: plot.monte_carlo(narrow(3000)),
    ],
    "identification": [lambda: plot.identification(identified(problem()))],
    "remaining_life": [remaining],
    "multi_fidelity": [cheaper],
    "overview": [lambda: plot.overview(run())],
    "path": [lambda: plot.path(run(), SLIDER, jc.Marker(SLIDER, (1e-3, 0.0)))],
    "phase_portrait": [lambda: plot.phase_portrait(run(), SLIDER)],
    "poincare_section": [lambda: plot.poincare_section(run(), JOINT, period=PERIOD)],
    "pointing_budget": [lambda: plot.pointing_budget(pointing())],
    "positions": [lambda: plot.positions(standing())],
    "reliability": [lambda: plot.reliability(jc.reliability(problem(), SUNK))],
    "result": [lambda: plot.result(sample(3))],
    "sensitivity": [
        lambda: plot.sensitivity(derivatives(VERDICT)),
        lambda: plot.sensitivity(derivatives(VERDICT + LONG + ". " + LONG + ". ")),
    ],
    "steady_cycle": [lambda: plot.steady_cycle(settled())],
    "shapley_effects": [lambda: plot.shapley_effects(jc.shapley_effects(problem(), 64))],
    "screening": [lambda: plot.screening(jc.screening(problem(), 4))],
    "sobol_indices": [lambda: plot.sobol_indices(jc.sobol_indices(problem(), 64))],
    "spectrum": [lambda: plot.spectrum(run(), JOINT, "force", period=PERIOD)],
    "surface": [lambda: plot.surface(jc.surface(problem()))],
    "sweep": [
        lambda: swept(clearance=WIDE),
        lambda: swept(clearance=WIDE, speed=[1e-3, 2e-3]),
        lambda: swept(clearance=[1e-3, 2e-3], speed=np.linspace(1e-3, 2e-3, 9)),
    ],
    "wear_life": [lambda: plot.wear_life(life())],
    "wear_life_sample": [lambda: plot.wear_life_sample(lives())],
    "wear_surface": [lambda: plot.wear_surface(run(), JOINT)],
    "wear_unrolled": [lambda: plot.wear_unrolled(run(), JOINT)],
    "work_precision": [lambda: plot.work_precision(advised())],
    "worst_case": [lambda: plot.worst_case(jc.worst_case(problem(), samples=16))],
}
EACH = [
    pytest.param(case, id=f"{name} {number}", marks=pytest.mark.slow if number else ())
    for name, own in CASES.items()
    for number, case in enumerate(own)
]


def test_every_plot_has_its_cases():
    """An animation is a page, and the centres of a journal's ends are numbers."""
    assert set(CASES) == set(plot.__all__) - {"animate", "end_centres"}


@pytest.mark.parametrize("case", EACH)
def test_all_texts_can_be_read(case):
    figure = case()
    assert isinstance(figure, matplotlib.figure.Figure)
    assert colliding(figure) == []


def test_texts_that_collide_are_found():
    figure = matplotlib.figure.Figure()
    axis = figure.subplots()
    axis.text(0.4, 0.5, "one text", rotation=30)
    axis.text(0.4, 0.5, "another", rotation=-30)
    axis.text(1.1, 0.5, "one that is too long for where it stands")
    found = colliding(figure)
    assert len(found) == 2 and "upon each other" in found[0] and "leaves" in found[1]


def heights(verdict):
    """Of the axes, in inches."""
    figure = plot.sensitivity(derivatives(verdict))
    figure.draw_without_rendering()
    return [axis.get_window_extent().height / figure.dpi for axis in figure.axes]


def test_axes_keep_their_height_whatever_a_verdict_says():
    np.testing.assert_allclose(heights("Agreed."), heights(VERDICT + LONG + ". " + LONG + ". "),
                               rtol=0.05)  # fmt: skip
