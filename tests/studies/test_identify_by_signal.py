"""Unknowns from signals themselves, where the answer is known."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

import jaxclear as jc
from jaxclear.studies.identification.several_records import next_record
from jaxclear.studies.identification.signal_fit import (
    CredibleInterval,
    correlation_time,
    shortest_interval,
)

TIME = np.linspace(0.0, 1.0, 100)
NOISE = 0.1
Uniform = jc.distribution.Uniform


def line(offset, slope):
    return {"y": offset + slope * jnp.asarray(TIME), "at one": offset + slope}


def lines(**priors):
    wide = {"offset": (0.0, 5.0), "slope": (0.0, 5.0)} | priors
    variables = {n: jc.Dimension(x, Uniform(half), unit="1") for n, (x, half) in wide.items()}
    return jc.FunctionProblem(line, variables)


def measured(values, noise=NOISE, time=TIME):
    return jc.Measurement(time, {"y": values}, {"y": jc.sensor.Series("y", noise=noise)})


def noisy(offset, slope, seed=0):
    return offset + slope * TIME + NOISE * np.random.default_rng(seed).standard_normal(len(TIME))


@pytest.fixture(scope="module")
def straight():
    return jc.identify(lines(), measured(noisy(1.0, 2.0)), how="signal")


# Normal equations.
DESIGN = np.stack([np.ones_like(TIME), TIME], axis=1)
INVERSE = np.linalg.inv(DESIGN.T @ DESIGN)


def test_intervals_of_a_straight_line_are_those_of_linear_least_squares(straight):
    """With a known noise; the priors are wide."""
    best = INVERSE @ DESIGN.T @ noisy(1.0, 2.0)
    for i, name in enumerate(("offset", "slope")):
        half = 1.96 * NOISE * np.sqrt(INVERSE[i, i])
        own = straight[name]
        # What is left may be alike over 1.2 samples by chance.
        assert own.estimate == pytest.approx(best[i], abs=0.2 * half)
        assert own.high - own.low == pytest.approx(2 * half, rel=0.25)
        assert own.verdict == "identified"
    assert straight["at one"].estimate == pytest.approx(best.sum(), abs=0.02)
    assert straight.explains is None and not straight.warned


def test_the_posterior_is_a_problem_for_other_studies(straight):
    found = jc.monte_carlo(straight.posterior(), 256).summary()
    row = found[found["response"] == "at one"].iloc[0]
    own = straight["at one"]
    assert row["mean"] == pytest.approx(own.estimate, abs=0.02)
    assert 3.92 * row["standard deviation"] == pytest.approx(own.high - own.low, rel=0.35)


def test_a_wrong_model_is_refused_or_what_is_alike_counts_once():
    """Where the noise is known it is refused; where not, residuals that are alike count as one."""
    bent = noisy(1.0, 2.0) + 2.0 * TIME**2
    found = jc.identify(lines(), measured(bent), how="signal")
    assert found.explains is False
    assert "times what its noise makes" in found.warned[0] and "statistics" in found.warned[0]
    assert {own.verdict for own in found.unknowns} == {"not identified"}
    found = jc.identify(lines(), measured(bent, noise=0.0), how="signal")
    assert "which count as one" in found.sentence()
    # Ten times as wide as independent residuals of the same size would be.
    left = bent - DESIGN @ np.linalg.lstsq(DESIGN, bent, rcond=None)[0]
    naive = 3.92 * left.std() * np.sqrt(INVERSE[1, 1])
    assert found["slope"].high - found["slope"].low > 1.5 * naive


def test_an_active_bound_is_no_interval_of_nothing():
    """The true slope is beyond the prior: the interval ends at the bound and has a width."""
    found = jc.identify(lines(slope=(0.0, 1.9)), measured(noisy(1.0, 2.0)), how="signal")["slope"]
    assert found.high == pytest.approx(1.9) and found.low < 1.89


def test_what_no_signal_shows_keeps_its_prior():
    unseen = lambda offset, slope: {"y": offset + 0 * slope * jnp.asarray(TIME)}
    both = {"offset": jc.Dimension(0.0, Uniform(5.0)), "slope": jc.Dimension(0.0, Uniform(5.0))}
    problem = jc.FunctionProblem(unseen, both)
    found = jc.identify(problem, measured(noisy(1.0, 0.0)), how="signal")
    assert found["offset"].verdict == "identified"
    assert found["slope"].verdict == "not identified"
    assert (found["slope"].low, found["slope"].high) == pytest.approx((-4.75, 4.75))


def test_several_records_tell_the_next_one_by_their_differences():
    """Offsets differ by far more than each record tells of itself."""
    offsets = [0.6, 1.4, 1.1, 0.9]
    records = [measured(noisy(own, 2.0, seed)) for seed, own in enumerate(offsets)]
    found = jc.identify(lines(), records, how="signal")
    factor = scipy.stats.t.ppf(0.975, 3) * np.sqrt(1.25)
    half = factor * np.std(offsets, ddof=1)
    own = found["offset"]
    assert 0.5 * (own.high - own.low) == pytest.approx(half, rel=0.15)
    assert '"offset"' in found.sentence() and "next record" in found.sentence()


def test_the_next_record_is_a_students_t():
    told = [CredibleInterval(x, 0.0, 0.0, 0.01, -9.0, 9.0) for x in (1.0, 2.0, 4.0)]
    own = next_record(told)
    values = np.array([1.0, 2.0, 4.0])
    half = scipy.stats.t.ppf(0.975, 2) * values.std(ddof=1) * np.sqrt(4 / 3)
    assert (own.low, own.high) == pytest.approx((values.mean() - half, values.mean() + half))
    # Records that agree by chance are not believed beyond what each tells.
    alike = next_record([own._replace(value=1.0, deviation=0.3) for own in told])
    assert alike.high - alike.low > 2 * 0.3 * 1.96


def test_samples_alike_over_some_time_count_as_one():
    """Of a first-order process with coefficient a one independent sample is (1 + a)/(1 - a)."""
    noise = np.random.default_rng(0).standard_normal(40_000)
    process = scipy.signal.lfilter([1.0], [1.0, -0.8], noise)
    assert correlation_time(process) == pytest.approx(9.0, rel=0.15)
    assert correlation_time(noise) == pytest.approx(1.0, abs=0.1)
    assert correlation_time(np.zeros(5)) == 1.0


def test_two_optima_that_explain_a_record_alike_are_both_in_the_interval():
    """Of c^2 the sign of c is not told."""
    squared = lambda c: {"y": c**2 * (1 + jnp.asarray(TIME))}
    problem = jc.FunctionProblem(squared, {"c": jc.Dimension(0.0, Uniform(2.0), unit="1")})
    record = measured(1.44 * (1 + TIME) + NOISE * np.random.default_rng(0).standard_normal(100))
    one = jc.identify(problem, record, how="signal")
    shares = np.mean(one.posterior_values > 0)
    assert 0.4 < shares < 0.6 and one["c"].width > 0.5
    assert np.abs(one.posterior_values).std() < 0.05


def _rig(size, rate, rest):
    return {"y": size * jnp.exp(-rate * jnp.asarray(TIME)) + rest}


@pytest.mark.slow
def test_intervals_of_a_hundred_rigs_hold_what_their_priors_drew():
    """Of truths that priors draw an interval of 95 % holds 95 % (300 of three unknowns, of which
    those of one rig are told together: 90 % are three deviations below)."""
    ends = {"size": (0.5, 2.0), "rate": (0.2, 5.0), "rest": (-0.5, 0.5)}
    dimensions = {
        name: jc.Dimension(0.5 * (low + high), Uniform(0.5 * (high - low)), unit="1")
        for name, (low, high) in ends.items()
    }
    problem, rng, held = jc.FunctionProblem(_rig, dimensions), np.random.default_rng(8), []
    for seed in range(100):
        truth = {name: rng.uniform(*pair) for name, pair in ends.items()}
        shown = np.asarray(_rig(**truth)["y"]) + 0.05 * rng.standard_normal(len(TIME))
        rig = jc.identify(problem, measured(shown, 0.05), how="signal", seed=seed)
        held += [rig[name].low <= true <= rig[name].high for name, true in truth.items()]
    assert np.mean(held) > 0.9


def test_the_shortest_interval_reaches_an_end_that_nothing_speaks_against():
    shares = np.linspace(0.0, 1.0, 2001) ** 4
    low, high = shortest_interval(shares)
    assert low == 0.0 and high == pytest.approx(0.95**4, abs=4e-3)
    assert shortest_interval(1 - shares)[1] == 1.0


# Lost motion of a STS3215 servo [counts of 360/4096 deg], without load and with one on a lever of
# 100 mm. Source: Kotov, "A low-cost platform for measuring backlash in popular UART servos", GitHub
# roboninecom/Measuring-Backlash-in-Popular-UART-Servos, table; CC BY 4.0. The text says 0.3 kgf,
# the caption of the table 1.5 and 3.0.
SERVO, COUNT, LEVER, KGF = (7.03, 14.78), 360 / 4096, 0.1, 9.80665


class Servo(eqx.Module):
    """Readings of play [deg] and stiffness [N m/rad] under a `load` [kgf]."""

    load: float | None

    def __call__(self, play, stiffness, load=None):
        torque = (self.load if load is None else load) * KGF * LEVER
        bent = jnp.rad2deg(2 * torque / stiffness)
        return {"y": jnp.stack([play, play + bent]) / COUNT}


def servo(load):
    stiff = jc.distribution.Lognormal(100.0, spread=1.0)
    unknowns = {
        "play": jc.Dimension(1.0, Uniform(1.0), unit="deg"),
        "stiffness": jc.Dimension(100.0, stiff, unit="N m/rad"),
    }
    if load is None:
        unknowns["load"] = jc.Dimension(1.65, Uniform(1.35), unit="kgf")
    return jc.FunctionProblem(Servo(load), unknowns)


@pytest.mark.slow
def test_of_a_servo_the_play_is_told_and_the_stiffness_by_the_load_that_is_meant():
    # A reading in whole counts is off by 1/sqrt(12) of one.
    record = measured(np.array(SERVO), noise=12**-0.5, time=np.array([0.0, 1.0]))
    for load, stiffness in ((0.3, 49.5), (3.0, 495.0)):
        found = jc.identify(servo(load), record, how="signal")
        assert found["play"].estimate == pytest.approx(0.618, abs=0.01)
        assert found["play"].verdict == "identified"
        assert found["stiffness"].estimate == pytest.approx(stiffness, rel=0.05)
    found = jc.identify(servo(None), record, how="signal")
    assert found["play"].verdict == "identified"
    assert found["load"].verdict != "identified"
    assert found["stiffness"].high > 4 * found["stiffness"].low
    assert "told together better than each alone" in found.sentence()


def swinging(stiffness=400.0, damping=1.0):
    """A mass on a slide that springs back from 10 mm."""
    axis = {"at": (0.0, 0.0, 0.0), "axis": "x"}
    slide = jc.joint.Prismatic(), jc.Marker("ground", **axis), jc.Marker("mass", **axis)
    return jc.Mechanism(
        {"mass": jc.Body(1.0, (1.0, 1.0, 1.0))},
        {"slide": jc.Connection(*slide)},
        {"spring": jc.load.JointSpring("slide", stiffness, damping=damping)},
        start={"slide": 0.01},
    )


def identified_spring(integrator):
    """A spring of 420 N/m and 1.3 N s/m, by the closed form of a damped oscillation."""
    time = np.linspace(0.0, 1.0, 101)
    decay, speed = 0.5 * 1.3, np.sqrt(420.0 - 0.25 * 1.3**2)
    wave = np.cos(speed * time) + decay / speed * np.sin(speed * time)
    noise = 1e-4
    shown = 0.01 * np.exp(-decay * time) * wave
    shown = shown + noise * np.random.default_rng(3).standard_normal(len(time))
    problem = jc.Problem(
        swinging(),
        {"place": lambda run: run.coordinate("slide")[-1]},
        {
            "stiffness": jc.Variable(lambda m: m.loads["spring"].stiffness, Uniform(100.0)),
            "damping": jc.Variable(lambda m: m.loads["spring"].damping, Uniform(0.9)),
        },
        duration=1.0,
        integrator=integrator,
    )
    sensors = {"x": jc.sensor.Displacement("mass", noise=noise)}
    return jc.identify(problem, jc.Measurement(time, {"x": shown}, sensors), 64, how="signal")


@pytest.mark.slow
def test_a_spring_is_told_by_how_its_mass_swings():
    found = identified_spring(jc.integrator.Adaptive())
    for name, true in (("stiffness", 420.0), ("damping", 1.3)):
        own = found[name]
        assert own.verdict == "identified" and own.low < true < own.high
    assert found["stiffness"].width < 0.05
    assert "By the steps" not in found.sentence()


@pytest.mark.slow
def test_what_steps_make_of_an_unknown_is_said():
    """By a symplectic method of order 2 a spring swings faster by (omega h)^2 / 24."""
    found = identified_spring(jc.integrator.FixedStep(2.5e-3, "semi_implicit"))
    own = found["stiffness"]
    assert not own.low < 420.0 < own.high
    (sentence,) = [x for x in found.remarks if "By the steps" in x and "stiffness" in x]
    moved = float(sentence.split("about ")[1].split()[0]) * (own.high - own.low) / 3.92
    assert moved == pytest.approx(abs(own.estimate - 420.0), rel=0.5)


def test_what_lies_outside_the_distributions_is_said_though_the_noise_is_not_known():
    near = lines(offset=(0.0, 1.0), slope=(0.0, 1.0))
    found = jc.identify(near, measured(noisy(8.0, 8.0), noise=0.0), how="signal")
    assert found.explains is False and "Wider distributions may" in found.warned[0]
    # A little outside is within the noise, and said of the end that the interval reaches.
    found = jc.identify(near, measured(noisy(0.0, 1.05)), how="signal")
    assert found["slope"].high == pytest.approx(1.0, abs=1e-4)
    assert 'interval of "slope" ends where its distribution does, at 1' in found.sentence()


def test_a_signal_without_any_noise_is_told_to_need_one():
    """No record is so; a constant one with noise is identified."""
    for signal in (0.0 * TIME, 1.0 + 2.0 * TIME):
        found = jc.identify(lines(), measured(signal, noise=0.0), how="signal")
        assert found.explains is False and "give its sensor one" in found.warned[0]
    found = jc.identify(lines(), measured(0.5 + 0.0 * TIME, noise=0.1), how="signal")
    assert found["offset"].low < 0.5 < found["offset"].high and "nan" not in found.sentence()
