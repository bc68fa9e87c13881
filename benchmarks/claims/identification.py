"""How often 95 % intervals of what is identified from one record hold the truth, and how far the
estimates are off: machines that the fit does not know, with another dissipation law, another
friction law and another integrator than its own.

    python -m benchmarks.claims.identification [--quick] [--rigs N] [--runs N] [--samples N]
        [--cases crank four-bar ball guide outside failure] [--json FILE]

`crank`: the slider-crank at 150 rad/s, one loose bearing, one accelerometer on the slider (noise of
2 % of the signal, gain known to 3 %), 16 turns of which the record has the last 12. `four-bar`:
three loose bearings, one accelerometer on the follower, 12 turns, the last 9. `ball`: the
slider-crank with a ball in a socket. `guide`: a quick-return mechanism with a loose guide, 7 turns,
the last 5. `outside`: slider-cranks with a linear elastic law, which is in no prior. `failure`: how
often the band of the cycle of failure holds the true one, of cranks whose clearance of 0.06 to
0.14 mm grows by 0.02 to 0.08 mm in a million cycles, of records after 0, 1 and 2 million; 0.5 mm is
the limit.

Hidden: a dissipation factor of Gonthier, CarvalhoMartins or HerbertMcWhannell, friction of
CoulombTanh (0.01 m/s) or Threlfall, integrator.Adaptive. The fit: LankaraniNikravesh, Flores and
HuntCrossley, Ambrosio and CoulombTanh, FixedStep. All hidden rigs of a case share the fit's sample,
so that their coverages hang together: spread them over several `--samples`.
"""

import dataclasses
import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, report, sign
from jaxclear.integrators import Outcome
from jaxclear.studies.identification.identify import answered, fit
from jaxclear.studies.identification.laws import ensemble
from jaxclear.studies.identification.result import NOT
from jaxclear.studies.identification.sample import sampled, watched
from jaxclear.studies.sampling import Drawing
from jaxclear.studies.store.batch import evaluate_all

LOSS, RUB = jc.contact.dissipation, jc.friction
HIDDEN = (LOSS.CarvalhoMartins, LOSS.HerbertMcWhannell, RUB.Threlfall)
# Samples a turn, noise as a share of the record's deviation, and how well gains are known.
PER, NOISE, GAIN = 128, 0.02, 0.03
# Of lives: cycles of the records, limit [m], clearances at first [m] and their growth [m/cycle].
CYCLES, LIMIT, WORN = (0.0, 1e6, 2e6), 0.5e-3, "clearance B"
FIRST, GROWTH = (0.06e-3, 0.14e-3), (0.02e-9, 0.08e-9)
LEVELS = (0.9, 0.95)


class Case(NamedTuple):
    """A kind of rig: `fit` and `hidden` problems, the `sensors` but for their noise and gain, how
    many of the `turns` settle, and the speed [rad/s]."""

    fit: jc.Problem
    hidden: jc.Problem
    sensors: dict[str, Any]
    turns: int
    settle: int
    speed: float


def uniform(low: float, high: float) -> jc.distribution.Uniform:
    return jc.distribution.Uniform(0.5 * (high - low))


def steel_on_steel() -> Any:
    steel = jc.Material(young_modulus=207e9, poisson_ratio=0.3)
    return jc.stiffness.HertzStiffness(steel, steel)


def laws(hidden: bool) -> tuple[Any, Any]:
    """Contact and friction in the middle of the priors."""
    contact = jc.contact.Gonthier if hidden else jc.contact.LankaraniNikravesh
    slow = jc.friction.CoulombTanh(mu_kinetic=0.08, transition_speed=1e-2)
    rub = slow if hidden else jc.friction.Ambrosio(mu_kinetic=0.08)
    return contact(stiffness=steel_on_steel(), restitution=0.775), rub


def priors(joints: str, gap: tuple[float, float], modulus: bool) -> dict[str, jc.Variable]:
    """A clearance for each joint, friction and restitution that all share, and the modulus."""
    every = lambda part: lambda rig: [part(rig.connections[name].joint) for name in joints]
    found = {
        f"clearance {name}": jc.Variable(
            lambda rig, name=name: rig.connections[name].joint.clearance, uniform(*gap)
        )
        for name in joints
    }
    found["friction"] = jc.Variable(
        every(lambda joint: joint.friction.mu_kinetic), uniform(0.01, 0.15)
    )
    found["restitution"] = jc.Variable(
        every(lambda joint: joint.contact.restitution), uniform(0.6, 0.95)
    )
    if modulus:
        stiff = lambda rig: rig.connections[joints].joint.contact.elastic.stiffness
        found["modulus"] = jc.Variable(
            lambda rig: [stiff(rig).inner.young_modulus, stiff(rig).outer.young_modulus],
            uniform(107e9, 307e9),
        )
    return found


def problem(rig: Any, variables: dict, speed: float, turns: int, integrator: Any) -> jc.Problem:
    return jc.Problem(
        rig,
        {"turned": jc.response.FinalCoordinate("O")},
        variables,
        duration=2 * np.pi / speed * turns,
        integrator=integrator,
    )


def fit_and_hidden(
    build: Callable, variables: dict, speed: float, turns: int, step: float | None = None
) -> tuple[jc.Problem, jc.Problem]:
    """The problem of the fit, in steps of so many seconds, and that of hidden machines, of the
    mechanism `build(contact, friction)`."""
    tight = jc.integrator.Adaptive()
    steps = tight if step is None else jc.integrator.FixedStep(step)
    fitted, hidden = (build(*laws(is_hidden)) for is_hidden in (False, True))
    return (
        problem(fitted, variables, speed, turns, steps),
        problem(hidden, variables, speed, turns, tight),
    )


def crank(joint: str = "planar", speed: float = 150.0) -> Case:
    gap, turns = (0.05e-3, 0.40e-3), 16
    middle = 0.5 * sum(gap)

    def build(contact: Any, rub: Any) -> jc.Mechanism:
        bearing: Any = "planar"
        if joint == "ball":
            bearing = jc.clearance.BallSocket(contact, rub, socket_radius=10e-3, clearance=middle)
        return jc.scenes.slider_crank(
            bearing, middle, contact=contact, friction=rub, crank_speed=speed
        )

    both = fit_and_hidden(build, priors("B", gap, True), speed, turns, 2e-6)
    return Case(*both, {"a": ON_SLIDER}, turns, 4, speed)


def ball() -> Case:
    return crank("ball")


def guide() -> Case:
    """The quick-return mechanism at 20 rad/s, loose between slider and guide."""
    gap, turns, speed = (0.05e-3, 0.40e-3), 7, 20.0

    def build(contact: Any, rub: Any) -> jc.Mechanism:
        middle = 0.5 * sum(gap)
        rig = jc.scenes.guide(clearance=middle, friction=rub, crank_speed=speed, torque=None)
        return eqx.tree_at(lambda rig: rig.connections["P"].joint.contact, rig, contact)

    both = fit_and_hidden(build, priors("P", gap, True), speed, turns, 1e-5)
    end = jc.sensor.Accelerometer(jc.Marker("guide", (1.0, 0.0)), "y")
    return Case(*both, {"a": end}, turns, 2, speed)


def outside() -> Case:
    """The slider-crank with a linear spring, a thousandth as stiff as Hertz's, for the fit's."""
    known, own = crank(), priors("B", (0.05e-3, 0.40e-3), False)
    soft = jc.contact.KelvinVoigt(stiffness=2e7, damping=200.0)
    rig = jc.scenes.slider_crank(
        "planar", 0.225e-3, contact=soft, friction=laws(True)[1], crank_speed=known.speed
    )
    del own["restitution"]
    hidden = problem(rig, own, known.speed, known.turns, jc.integrator.Adaptive())
    return known._replace(hidden=hidden)


def four_bar() -> Case:
    """Links of 0.1, 0.4, 0.3 and 0.3 m at 100 rad/s, all pins but the crank's own loose."""
    gap, turns, speed = (0.03e-3, 0.20e-3), 12, 100.0
    at = lambda body, x: jc.Marker(body, (x, 0.0))
    drive = jc.joint.Revolute(drive=jc.drive.ConstantSpeed(speed))

    def build(contact: Any, rub: Any) -> jc.Mechanism:
        loose = jc.clearance.PlanarJournalBearing(
            contact, rub, bearing_radius=10e-3, clearance=0.5 * sum(gap)
        )
        return jc.Mechanism(
            {
                "crank": jc.Body(0.3, 2.5e-4, (0.05, 0.0)),
                "coupler": jc.Body(0.4, 0.4 * 0.4**2 / 12, (0.2, 0.0)),
                "follower": jc.Body(0.35, 0.35 * 0.3**2 / 12, (0.15, 0.0)),
            },
            {
                "O": jc.Connection(drive, "ground", "crank"),
                "A": jc.Connection(loose, at("crank", 0.1), at("coupler", 0.0)),
                "B": jc.Connection(loose, at("coupler", 0.4), at("follower", 0.3)),
                "C": jc.Connection(loose, at("ground", 0.3), at("follower", 0.0)),
            },
            loads={"gravity": jc.load.Gravity((0.0, -9.81))},
            guess={"A": 0.8128, "C": 1.318},
        )

    both = fit_and_hidden(build, priors("ABC", gap, False), speed, turns, 4e-6)
    middle = jc.sensor.Accelerometer(at("follower", 0.15), "y")
    return Case(*both, {"a": middle}, turns, 3, speed)


ON_SLIDER = jc.sensor.Accelerometer("slider", "x")
CASES = {
    "crank": crank,
    "four-bar": four_bar,
    "ball": ball,
    "guide": guide,
    "outside": outside,
}
USUAL_RUNS = {"four-bar": 512}


def sensors(case: Case, noise: dict[str, float], gain: Any) -> dict[str, Any]:
    found: dict[str, Any] = {
        name: dataclasses.replace(own, noise=noise[name], gain=gain)
        for name, own in case.sensors.items()
    }
    return found | {"crank": jc.sensor.Encoder("O")}


def record_of(case: Case, signals: dict[str, np.ndarray], noise: Any, gain: Any) -> jc.Measurement:
    rate = PER * case.speed / (2 * np.pi)
    first = case.settle * PER
    time = np.arange(case.turns * PER + 1)[first:] / rate
    own = {name: values[first:] for name, values in signals.items()}
    return jc.Measurement(time, own, sensors(case, noise, gain), turn="crank")


def hidden_question(case: Case) -> tuple[jc.Measurement, Any, Any]:
    """(an empty record, the laws of hidden rigs, their problem with signals)."""
    blank = {name: np.zeros(case.turns * PER + 1) for name in (*case.sensors, "crank")}
    blank["crank"] = np.arange(case.turns * PER + 1.0)
    empty = record_of(case, blank, dict.fromkeys(case.sensors, 0.0), 1.0)
    chosen = ensemble(case.hidden.mechanism, HIDDEN)
    return empty, chosen, watched(case.hidden, empty, chosen)


def noisy_records(
    case: Case, signals: dict[str, np.ndarray], rng: np.random.Generator, gain: Any = 1.0
) -> list[jc.Measurement]:
    """A record of each rig, from signals without noise."""
    sizes = {name: float(np.median(signals[name].std(axis=1))) for name in case.sensors}
    noise = {name: NOISE * size for name, size in sizes.items()}
    shown, rate = sensors(case, noise, gain), PER * case.speed / (2 * np.pi)
    seen = {name: shown[name].sensed(values, rate, rng) for name, values in signals.items()}
    count = len(next(iter(seen.values())))
    return [
        record_of(case, {name: values[i] for name, values in seen.items()}, noise, gain)
        for i in range(count)
    ]


class Answers(NamedTuple):
    """Of the rigs of one sample, (rigs, unknowns): the truth, ends, estimates and widths of the
    intervals, whether as not identified, what the sample says of itself (unknowns,), and the share
    of the records that no run explains."""

    truth: np.ndarray
    low: np.ndarray
    high: np.ndarray
    estimate: np.ndarray
    width: np.ndarray
    refused: np.ndarray
    calibrated: np.ndarray
    unexplained: float


def answers(case: Case, rigs: int, runs: int, seed: int) -> Answers:
    """What is told of hidden rigs by one sample."""
    rng = np.random.default_rng(seed)
    empty, law_choices, question = hidden_question(case)
    hidden = sampled(case.hidden, empty, question, law_choices, rigs, 1000 + seed)
    gain = jc.Dimension(1.0, jc.distribution.Normal(GAIN), unit="1")
    records = noisy_records(case, hidden.signals, rng, gain)
    chosen = ensemble(case.fit.mechanism)
    asked = watched(case.fit, records[0], chosen)
    sample = sampled(case.fit, records[0], asked, chosen, runs, seed)
    fitted = fit(case.fit, records[0], sample, seed)
    found = [answered(fitted, own) for own in records]
    parts = {
        part: np.array([[getattr(row, part) for row in one.unknowns] for one in found])
        for part in ("low", "high", "estimate", "width", "verdict")
    }
    unexplained = float(np.mean([one.explains is False for one in found]))
    verdicts = parts.pop("verdict")
    own = np.array(list(found[0].calibration().values()))
    nothing = np.full(len(hidden.values), np.nan)
    known = dict(zip(case.hidden.names, hidden.values.T, strict=True))
    truth = np.stack([known.get(name, nothing) for name in case.fit.names], axis=1)
    return Answers(truth, **parts, refused=verdicts == NOT, calibrated=own, unexplained=unexplained)


def measured(name: str, rigs: int, runs: int, seeds: int) -> list[dict]:
    """A row for each unknown: how many of the rigs have it in its interval, how far its estimates
    are off, and how often it is named as not identified."""
    case = CASES[name]()
    every = [answers(case, rigs // seeds, runs, seed) for seed in range(seeds)]
    truth, low, high, estimate, width, refused = (
        np.concatenate([getattr(one, part) for one in every])
        for part in ("truth", "low", "high", "estimate", "width", "refused")
    )
    rows = []
    for k, unknown in enumerate(case.fit.names):
        if np.isnan(truth[:, k]).any():
            continue
        half = float(case.fit.variables[unknown].distribution.half_width)
        off, held = estimate[:, k] - truth[:, k], (low <= truth) & (truth <= high)
        each = [100 * np.mean((o.low <= o.truth) & (o.truth <= o.high), 0)[k] for o in every]
        rows.append(
            {
                "unknown": unknown,
                "rigs": len(truth),
                "held [%]": 100 * np.mean(held[:, k]),
                "of one sample, least [%]": min(each),
                "rms error [% of range]": 100 * np.sqrt(np.mean(off**2)) / (2 * half),
                "bias [% of range]": 100 * np.mean(off) / (2 * half),
                "median width [% of prior's]": 100 * np.median(width[:, k]),
                "not identified [%]": 100 * np.mean(refused[:, k]),
                "calibration [%]": 100 * np.mean([one.calibrated[k] for one in every]),
                "records not explained [%]": 100 * np.mean([one.unexplained for one in every]),
            }
        )
    return rows


def failure_rows(rigs: int, runs: int) -> list[dict]:
    """How often the band of the cycle of failure holds the true one, of hidden slider-cranks whose
    clearance grows steadily, each recorded at three times."""
    case, rng = crank(), np.random.default_rng(5)
    empty, _, question = hidden_question(case)
    # Each rig keeps its friction, restitution, modulus and laws; its clearance grows.
    values = np.repeat(Drawing(question, 77, "sobol", 1).span(0, rigs), len(CYCLES), axis=0)
    first, growth = rng.uniform(*FIRST, rigs), rng.uniform(*GROWTH, rigs)
    grown = first[:, None] + growth[:, None] * np.array(CYCLES)
    values[:, question.names.index(WORN)] = grown.ravel()
    result = evaluate_all(question, jnp.asarray(values), label="hidden")
    signals = {name: np.asarray(result.responses[f"signal {name}"]) for name in empty.sensors}
    records = noisy_records(case, signals, rng)
    chosen = ensemble(case.fit.mechanism)
    sample = sampled(case.fit, records[0], watched(case.fit, records[0], chosen), chosen, runs, 0)
    fitted = fit(case.fit, records[0], sample)
    estimates = [answered(fitted, record) for record in records]
    good = np.asarray(result.outcome).reshape(rigs, -1) == Outcome.REACHED
    truth, rows = (LIMIT - first) / growth, []
    for times, level in itertools.product(((0, 2), (0, 1, 2)), LEVELS):
        held, width, off = [], [], []
        for i in np.flatnonzero(good.all(axis=1)):
            by_cycle = {CYCLES[k]: estimates[len(CYCLES) * i + k] for k in times}
            life = jc.remaining_life(by_cycle, WORN, LIMIT, level=level)
            middle, low, high = life.failure_band
            held.append(low <= truth[i] <= high)
            width.append((high - low) / truth[i])
            off.append(middle / truth[i] - 1)
        rows.append(
            {
                "records": len(times),
                "band [%]": 100 * level,
                "rigs": len(held),
                "held [%]": 100 * np.mean(held),
                "median width [% of the life]": 100 * np.median(width),
                "median error [%]": 100 * np.median(np.abs(off)),
            }
        )
    return rows


def main() -> None:
    options = arguments(
        __doc__,
        cases={"nargs": "*", "default": list(CASES), "choices": [*CASES, "failure"]},
        rigs={"type": int, "default": 128, "help": "hidden, of each case"},
        runs={"type": int, "help": "of each sample; by default 256 or 512"},
        samples={"type": int, "default": 1, "help": "that the rigs are spread over"},
    )
    if options.quick:
        options.cases, options.rigs, options.runs = options.cases[:1], 8, 64
    for name in options.cases:
        runs = options.runs or USUAL_RUNS.get(name, 256)
        if name == "failure":
            title, rows = "Cycle of failure", failure_rows(options.rigs, runs)
        else:
            rows = measured(name, options.rigs, runs, options.samples)
            title = f"Identified: {name}"
        report(title, rows, options)
        sign("benchmarks.claims.identification", options.json, [title])


if __name__ == "__main__":
    main()
