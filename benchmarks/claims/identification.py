"""How often 95 % intervals of what is identified from one record hold the truth, and how far the
estimates are off: machines that the fit does not know, with another dissipation law, another
friction law and another integrator than its own.

    python -m benchmarks.claims.identification [--quick] [--rigs N] [--runs N] [--samples N]
        [--cases crank four-bar ball guide outside untold] [--json FILE]

`crank`: the slider-crank at 150 rad/s, one loose bearing, one accelerometer on the slider (noise of
2 % of the signal, gain known to 3 %), 16 turns of which the record has the last 12. `four-bar`:
three loose bearings, one accelerometer on the follower, 12 turns, the last 9. `ball`: the
slider-crank with a ball in a socket. `guide`: a quick-return mechanism with a loose guide, 7 turns,
the last 5. `outside`: slider-cranks with a linear elastic law, which is in no prior; `outside,
wide`: where the modulus may be far below steel's. `untold`: unknowns that their records cannot
tell.

Hidden: a dissipation factor of Gonthier, CarvalhoMartins or HerbertMcWhannell, friction of
CoulombTanh (0.01 m/s) or Threlfall, integrator.Adaptive. The fit: LankaraniNikravesh, Flores and
HuntCrossley, Ambrosio and CoulombTanh, FixedStep. All hidden rigs of a case share the fit's sample,
so that their coverages hang together: spread them over several `--samples`.
"""

import argparse
import dataclasses
import time
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
import scipy.stats

import jaxclear as jc
from benchmarks.measure import report, sign
from jaxclear.studies.identification.identify import answered, fit
from jaxclear.studies.identification.laws import ensemble
from jaxclear.studies.identification.result import NOT
from jaxclear.studies.identification.sample import sampled, watched

LOSS, RUB = jc.contact.dissipation, jc.friction
HIDDEN = (LOSS.CarvalhoMartins, LOSS.HerbertMcWhannell, RUB.Threlfall)
# Samples a turn, noise as a share of the record's deviation, and how well gains are known.
PER, NOISE, GAIN = 128, 0.02, 0.03


class Case(NamedTuple):
    """A kind of rig: `fit` and `hidden` problems, the `sensors` but for their noise and gain, how
    many of the `turns` settle, the speed [rad/s], the `untold` unknowns, and the noise [its unit]
    where it is no share of the signal."""

    fit: jc.Problem
    hidden: jc.Problem
    sensors: dict[str, Any]
    turns: int
    settle: int
    speed: float
    untold: tuple[str, ...] = ()
    noise: float | None = None


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


def crank(joint: str = "planar", speed: float = 150.0) -> Case:
    gap, turns = (0.05e-3, 0.40e-3), 16
    steps = {False: jc.integrator.FixedStep(2e-6), True: jc.integrator.Adaptive()}
    made = {}
    for hidden, integrator in steps.items():
        contact, rub = laws(hidden)
        middle = 0.5 * sum(gap)
        own: Any = "planar"
        if joint == "ball":
            own = jc.clearance.BallSocket(contact, rub, socket_radius=10e-3, clearance=middle)
        rig = jc.scenes.slider_crank(own, middle, contact=contact, friction=rub, crank_speed=speed)
        made[hidden] = problem(rig, priors("B", gap, True), speed, turns, integrator)
    return Case(made[False], made[True], {"a": ON_SLIDER}, turns, 4, speed)


def ball() -> Case:
    return crank("ball")


def guide() -> Case:
    """The quick-return mechanism at 20 rad/s, loose between slider and guide."""
    gap, turns, speed = (0.05e-3, 0.40e-3), 7, 20.0
    steps = {False: jc.integrator.FixedStep(1e-5), True: jc.integrator.Adaptive()}
    made = {}
    for hidden, integrator in steps.items():
        contact, rub = laws(hidden)
        rig = jc.scenes.guide(
            clearance=0.5 * sum(gap), friction=rub, crank_speed=speed, torque=None
        )
        rig = eqx.tree_at(lambda own: own.connections["P"].joint.contact, rig, contact)
        made[hidden] = problem(rig, priors("P", gap, True), speed, turns, integrator)
    end = jc.sensor.Accelerometer(jc.Marker("guide", (1.0, 0.0)), "y")
    return Case(made[False], made[True], {"a": end}, turns, 2, speed)


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


def outside_wide() -> Case:
    """The same with a modulus that may be a hundredth of steel's to twice that."""
    known, wide = outside(), scipy.stats.loguniform(207e7, 414e9)
    prior = jc.distribution.FromScipy(wide, about=207e9)
    where = lambda own: own.variables["modulus"].distribution
    return known._replace(fit=eqx.tree_at(where, known.fit, prior))


def four_bar() -> Case:
    """Links of 0.1, 0.4, 0.3 and 0.3 m at 100 rad/s, all pins but the crank's own loose."""
    gap, turns, speed = (0.03e-3, 0.20e-3), 12, 100.0
    steps = {False: jc.integrator.FixedStep(4e-6), True: jc.integrator.Adaptive()}
    made = {}
    for hidden, integrator in steps.items():
        loose = jc.clearance.PlanarJournalBearing(
            *laws(hidden), bearing_radius=10e-3, clearance=0.5 * sum(gap)
        )
        at = lambda body, x: jc.Marker(body, (x, 0.0))
        drive = jc.joint.Revolute(drive=jc.drive.ConstantSpeed(speed))
        rig = jc.Mechanism(
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
        made[hidden] = problem(rig, priors("ABC", gap, False), speed, turns, integrator)
    middle = jc.sensor.Accelerometer(jc.Marker("follower", (0.15, 0.0)), "y")
    return Case(made[False], made[True], {"a": middle}, turns, 3, speed)


def loaded() -> Case:
    """A slider-crank at 20 rad/s whose loose joint never unloads, by 60 N on the slider."""
    speed, turns = 20.0, 5
    made = {}
    for hidden in (False, True):
        contact, _ = laws(hidden)
        rub = jc.friction.CoulombTanh(mu_kinetic=0.08, transition_speed=1e-2)
        rig = jc.scenes.slider_crank(
            "planar", 0.225e-3, contact=contact, friction=rub, crank_speed=speed
        )
        push = {"push": jc.load.Force(jc.Marker("slider"), (-60.0, 0.0))}
        rig = jc.Mechanism(
            rig.bodies, rig.connections, loads=dict(rig.loads) | push, guess={"G": 0.17}
        )
        own = priors("B", (0.05e-3, 0.40e-3), True)
        made[hidden] = problem(rig, own, speed, turns, jc.integrator.Adaptive())
    known = Case(made[False], made[True], {"a": ON_SLIDER}, turns, 1, speed)
    return known._replace(untold=known.fit.names)


def on_the_crank() -> Case:
    """The accelerometer sits on the crank, whose speed is given."""
    known = crank()
    sensor = jc.sensor.Accelerometer(jc.Marker("crank", (0.05, 0.0)), "x")
    return known._replace(sensors={"a": sensor}, untold=known.fit.names)


def coarse() -> Case:
    """In the place of the accelerometer a gauge of the slider's place that is good to 20 mm."""
    known = crank()
    gauge = jc.sensor.Displacement("slider", "x")
    return known._replace(sensors={"a": gauge}, untold=known.fit.names, noise=20e-3)


def ideal() -> Case:
    """Masses and moments of inertia of a slider-crank without gaps at a given speed."""
    speed, turns = 50.0, 5
    rig = jc.scenes.slider_crank("ideal", crank_speed=speed)
    own = {
        f"mass of the {name}": jc.Variable(
            lambda rig, name=name: rig.bodies[name].mass, uniform(-0.05, 0.05)
        )
        for name in rig.bodies
    }
    own["inertia of the rod"] = jc.Variable(
        lambda rig: rig.bodies["rod"].inertia, uniform(-1e-4, 1e-4)
    )
    own["inertia of the crank"] = jc.Variable(
        lambda rig: rig.bodies["crank"].inertia, uniform(-5e-5, 5e-5)
    )
    own["centre of the rod"] = jc.Variable(lambda rig: rig.bodies["rod"].com[0], uniform(0, 0.04))
    known = problem(rig, own, speed, turns, jc.integrator.Adaptive())
    return Case(known, known, {"a": ON_SLIDER}, turns, 1, speed, tuple(own))


def rattling() -> Case:
    return crank()._replace(untold=("restitution", "modulus"))


ON_SLIDER = jc.sensor.Accelerometer("slider", "x")
CASES = {
    "crank": crank,
    "four-bar": four_bar,
    "ball": ball,
    "guide": guide,
    "outside": outside,
    "outside, wide": outside_wide,
}
UNTOLD = {
    "never unloads": loaded,
    "rattles": rattling,
    "sensor on the driven crank": on_the_crank,
    "gauge of 20 mm": coarse,
    "ideal joints": ideal,
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


def hidden_rigs(case: Case, rigs: int, seed: int) -> Any:
    """Signals, without noise, of rigs that the fit does not know."""
    blank = {name: np.zeros(case.turns * PER + 1) for name in (*case.sensors, "crank")}
    blank["crank"] = np.arange(case.turns * PER + 1.0)
    nothing = record_of(case, blank, dict.fromkeys(case.sensors, 0.0), 1.0)
    known = ensemble(case.hidden.mechanism, HIDDEN)
    asked = watched(case.hidden, nothing, known)
    return sampled(case.hidden, nothing, asked, known, rigs, 1000 + seed)


class Answers(NamedTuple):
    """Of the rigs of one sample, (rigs, unknowns): the truth, ends, estimates and widths of what
    was told, whether as not identified, and what the sample says of itself (unknowns,); and beside
    these what it took."""

    truth: np.ndarray
    low: np.ndarray
    high: np.ndarray
    estimate: np.ndarray
    width: np.ndarray
    refused: np.ndarray
    calibrated: np.ndarray
    beside: dict[str, float]


def answers(case: Case, rigs: int, runs: int, seed: int) -> Answers:
    """What is told of hidden rigs by one sample."""
    rng = np.random.default_rng(seed)
    hidden = hidden_rigs(case, rigs, seed)
    gain = jc.Dimension(1.0, jc.distribution.Normal(GAIN), unit="1")
    sizes = {n: float(np.median(hidden.signals[n].std(axis=1))) for n in case.sensors}
    noise = {n: case.noise or NOISE * size for n, size in sizes.items()}
    shown = sensors(case, noise, gain)
    rate = PER * case.speed / (2 * np.pi)
    seen = {n: shown[n].sensed(own, rate, rng) for n, own in hidden.signals.items()}
    records = [
        record_of(case, {n: own[i] for n, own in seen.items()}, noise, gain)
        for i in range(len(hidden.values))
    ]
    begun = time.perf_counter()
    chosen = ensemble(case.fit.mechanism, None)
    asked = watched(case.fit, records[0], chosen)
    sample = sampled(case.fit, records[0], asked, chosen, runs, seed)
    ran = time.perf_counter() - begun
    fitted = fit(case.fit, records[0], sample, jc.signal.usual_statistics(True), seed)
    found = [answered(fitted, records[0])]
    took = time.perf_counter() - begun
    found += [answered(fitted, own) for own in records[1:]]
    parts = {
        part: np.array([[getattr(row, part) for row in one.unknowns] for one in found])
        for part in ("low", "high", "estimate", "width", "verdict")
    }
    beside = {
        "runs": len(sample.values),
        "failed": sample.failed,
        "runs, with compiling [s]": ran,
        "in all [s]": took,
        "not explained [%]": 100 * float(np.mean([one.explains is False for one in found])),
    }
    verdicts = parts.pop("verdict")
    own = np.array(list(found[0].calibration().values()))
    nothing = np.full(len(hidden.values), np.nan)
    known = dict(zip(case.hidden.names, hidden.values.T, strict=True))
    truth = np.stack([known.get(name, nothing) for name in case.fit.names], axis=1)
    return Answers(truth, **parts, refused=verdicts == NOT, calibrated=own, beside=beside)


def measured(name: str, rigs: int, runs: int, seeds: int) -> tuple[list[dict], list[dict]]:
    """A row for each unknown: how many of the rigs have it in its interval, how far its estimates
    are off, and how often it is named as not identified; and what each sample took."""
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
            }
        )
    return rows, [one.beside for one in every]


def untold_rows(rigs: int, runs: int) -> list[dict]:
    """Of unknowns that no record can tell, how often they are named so."""
    rows = []
    for kind, make in UNTOLD.items():
        case = make()
        found = answers(case, rigs, runs, 0)
        for k, name in enumerate(case.fit.names):
            if name in case.untold:
                named, width = 100 * np.mean(found.refused[:, k]), np.median(found.width[:, k])
                row = {"record": kind, "unknown": name, "rigs": rigs, "named [%]": named}
                rows.append(row | {"median width [% of prior's]": 100 * width})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=[*CASES, "untold"])
    parser.add_argument("--rigs", type=int, default=128, help="hidden, of each case")
    parser.add_argument("--runs", type=int, help="of each sample; by default 256 or 512")
    parser.add_argument("--samples", type=int, default=1, help="that the rigs are spread over")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.quick:
        options.cases, options.rigs, options.runs = ["crank"], 8, 64
    if "untold" in options.cases:
        options.cases.remove("untold")
        report("Untold", untold_rows(min(options.rigs, 10), options.runs or 256), options)
        sign("benchmarks.claims.identification", options.json, ["Untold"])
    for name in options.cases:
        runs = options.runs or USUAL_RUNS.get(name, 256)
        rows, beside = measured(name, options.rigs, runs, options.samples)
        titles = [f"Identified: {name}", f"What it took: {name}"]
        report(titles[0], rows, options)
        report(titles[1], beside, options)
        sign("benchmarks.claims.identification", options.json, titles)


if __name__ == "__main__":
    main()
