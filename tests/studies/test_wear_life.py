"""The wear of a life against closed forms: of a journal on a ring that turns under a load that
falls with wear, and of the steps alone."""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear import plot
from jaxclear.studies.life import rates
from jaxclear.studies.life.steps import Cells, Machine, Node, Rate, live, live_by_jumps
from tests.rigs.figures import assert_complete
from tests.rigs.refusals import refusals
from tests.rigs.wearing_ring import (
    FORCE,
    LENGTH,
    RADIUS,
    SAVES,
    SLOPE,
    STIFFNESS,
    TURN,
    ClosedForm,
    problem,
    uniform,
    wearing_ring,
)

# Depth [m] at which the force of each law has fallen to about a half.
DEPTHS = {False: 5e-6, True: 1e-5}


class Lived(NamedTuple):
    law: ClosedForm
    turns: float
    problem: jc.Problem

    def life(self, **kwargs):
        return jc.wear_life(self.problem, cycles=self.turns, **kwargs)

    def error(self, life):
        return float(life.over_life("depth")[-1]) / DEPTHS[self.law.hyperbolic] - 1


@pytest.fixture(scope="module", params=[False, True], ids=["exponential", "square root"])
def lived(request):
    law = ClosedForm(hyperbolic=request.param)
    turns = law.turns(DEPTHS[request.param])
    return Lived(law, turns, problem(wearing_ring(hyperbolic=request.param)))


@pytest.mark.parametrize(("tolerance", "within", "cycles"), [(0.2, 1e-2, 10), (1e-2, 1e-3, 15)])
def test_a_load_that_falls_with_wear_follows_its_closed_form(lived, tolerance, within, cycles):
    """The estimated error is the true one up to a factor of five."""
    life = lived.life(accuracy=tolerance)
    true = abs(lived.error(life))
    assert true < within and life.error < min(tolerance, 2 * within)
    assert 1.0 <= life.error / true <= 5.0
    assert life.simulated <= cycles and not life.ended and not life.warnings
    assert uniform(life.worn()["B"]["bearing"]) < 1e-3
    forces = life.over_life("force")
    wanted = [lived.law.force_at(float(h)) for h in life.over_life("depth")]
    # Cycles that count as settled end within 1e-3 of a clearance of where they began.
    np.testing.assert_allclose(forces, wanted, rtol=max(5e-4, 0.02 * tolerance))
    assert life.cycles[-1] == pytest.approx(lived.turns)


def test_between_stages_and_until_a_limit(lived):
    life = lived.life()
    places = np.linspace(0.0, lived.turns, 7)
    wanted = [lived.law.depth(float(n)) if n else 0.0 for n in places]
    size = DEPTHS[lived.law.hyperbolic]
    np.testing.assert_allclose(life.over_life("depth", places), wanted, atol=5e-3 * size)
    limit = 0.6 * size
    found = life.until("depth", limit)
    assert abs(found.cycles - lived.law.turns(limit)) < found.error < 0.01 * found.cycles
    assert "reaches" in found.sentence
    force = lived.law.force_at(limit)
    found = life.until("force", force)
    assert abs(found.cycles - lived.law.turns(limit)) < found.error
    never = life.until("volume", 1.0)
    assert np.isinf(never.cycles) and "does not reach 1; at its last rate" in never.sentence


@pytest.mark.slow(sample=False)
def test_wear_that_hangs_on_the_saving_times_is_told(lived):
    """An update every four cells of the wall makes waves of 3 % of the depth (of a quarter where
    arcs were widened by the contact): told by cycles whose saving intervals are cells, true of
    cycles that are updated so rarely. Over the life they level; the volume is the same."""
    life, asked = lived.life(), lived.problem
    told, is_worn = life.by_saves, lambda node: isinstance(node, jc.Wearing)
    rarely = lambda node: (
        dataclasses.replace(node, updates=(SAVES - 1) // 4) if is_worn(node) else node
    )
    rig = jax.tree.map(rarely, asked.mechanism, is_leaf=is_worn)
    few = jc.Problem(
        rig, asked.response, {}, duration=TURN, integrator=asked.integrator, save=SAVES
    )
    other = jc.wear_life(few, cycles=lived.turns)
    mine, waved = (each.stages[0].settled.wear["B"]["bearing"] for each in (life, other))
    off = np.sqrt(np.mean((waved - mine) ** 2)) / np.mean(mine)
    assert 0.02 < off < 0.05 and told[0] == pytest.approx(off, rel=0.05)
    assert "at a fourth of these a cycle would spread wear otherwise" in life.sentence()
    ends = [np.asarray(each.worn()["B"]["bearing"]) for each in (life, other)]
    assert np.sqrt(np.mean((ends[1] - ends[0]) ** 2)) < told.max() * np.mean(ends[0])
    volumes = [each.over_life("volume")[-1] for each in (life, other)]
    assert volumes == [each.at_end("volume") for each in (life, other)]
    with pytest.raises(ValueError, match="cycles of this life is .*; it must be one finite number"):
        life.over_life("volume", [0.0, 2 * life.cycles[-1]])
    np.testing.assert_allclose(*volumes, rtol=5e-3)
    assert list(life.table()["by saving times"]) == list(told)


def test_jumps_of_fixed_length_are_of_first_order(lived):
    """As the papers step: half the jump, half the error, and the estimate tells it."""
    errors = []
    for count in (8, 16):
        life = lived.life(jump=lived.turns / count)
        errors.append(lived.error(life))
        assert errors[-1] < life.error < 2 * errors[-1]
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)


def test_volume_of_a_constant_load_is_that_of_archard():
    """However deep the wall, every turn takes the volume k F s / H."""
    ring = wearing_ring(slope=0.0)
    life = jc.wear_life(problem(ring), cycles=1e6)
    lost = [stage.settled.last.volumes["B"]["bearing"] for stage in life.stages[1:]]
    assert life.over_life("depth")[-1] > 1e-5
    # The order in which a turn wears the cells leaves the wall uneven by a hundred-thousandth.
    np.testing.assert_allclose(lost, lost[0], rtol=1e-5)
    way = 2 * np.pi * (RADIUS + 0.5 * FORCE / STIFFNESS)
    assert lost[0] == pytest.approx(1e-5 / 2e9 * FORCE * way, rel=1e-6)
    assert life.simulated <= 10
    volume = life.over_life("volume")
    np.testing.assert_allclose(np.diff(volume) / np.diff(life.cycles), lost[0], rtol=1e-4)
    np.testing.assert_allclose(
        life.over_life("depth")[-1] * 2 * np.pi * RADIUS * LENGTH, volume[-1], rtol=3e-4
    )


@pytest.mark.slow
def test_a_life_of_two_cycles_is_two_cycles():
    """Nothing is carried on where nothing is saved by it."""
    fast = eqx.tree_at(
        lambda r: r.connections["B"].joint.bearing_wear.law.wear_coefficient,
        wearing_ring(),
        jnp.asarray(1e-2),
    )
    start = jc.steady_cycle(problem(fast), tolerance=1e-9)
    state = start.state
    life = jc.wear_life(problem(fast, state=state), cycles=2)
    first = jc.steady_cycle(problem(fast, state=state), cycles=1).run
    second = jc.steady_cycle(problem(fast, state=first.state()), cycles=1).run
    assert life.simulated == 3 and life.error == 0.0
    brute = np.asarray(second.worn["B"]["bearing"])
    np.testing.assert_allclose(life.worn()["B"]["bearing"], brute, rtol=1e-6)
    assert brute.max() > 3e-8


def test_an_interrupted_life_goes_on_bit_for_bit(tmp_path, monkeypatch):
    asked = problem(wearing_ring())
    turns = ClosedForm().turns(DEPTHS[False])
    whole = jc.wear_life(asked, cycles=turns)
    simulate, done = rates.cycle, []

    def interrupted(*args):
        if len(done) == 5:
            raise KeyboardInterrupt
        done.append(1)
        return simulate(*args)

    monkeypatch.setattr(rates, "cycle", interrupted)
    with pytest.raises(KeyboardInterrupt):
        jc.wear_life(asked, cycles=turns, store=tmp_path / "life")
    counted = []
    monkeypatch.setattr(rates, "cycle", lambda *args: counted.append(1) or simulate(*args))
    life = jc.wear_life(problem(wearing_ring()), cycles=turns, store=tmp_path / "life")
    assert len(counted) == whole.simulated - 5 and life.simulated == whole.simulated
    np.testing.assert_array_equal(life.worn()["B"]["bearing"], whole.worn()["B"]["bearing"])
    np.testing.assert_array_equal(life.errors, whole.errors)
    np.testing.assert_array_equal(life.over_life("force"), whole.over_life("force"))
    # What is complete is read.
    counted.clear()
    jc.wear_life(asked, cycles=turns, store=tmp_path / "life")
    assert not counted
    # A longer life takes over what it can.
    jc.wear_life(asked, cycles=2 * turns, store=tmp_path / "life")
    assert counted


def test_a_store_of_another_problem_is_refused(tmp_path):
    jc.wear_life(problem(wearing_ring()), cycles=1, store=tmp_path / "life")
    other = problem(wearing_ring(slope=2 * SLOPE))
    sentence = r"loads\[\"press\"\]\.slope is 100000\.0 there, 200000\.0 here"
    with pytest.raises(ValueError, match=sentence):
        jc.wear_life(other, cycles=1, store=tmp_path / "life")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter").write_text("dear")
    with pytest.raises(ValueError, match="not empty and holds no study"):
        jc.wear_life(other, cycles=1, store=tmp_path / "full")


def test_a_limit_that_is_not_reached_is_forecast_at_the_last_rate():
    """At a constant load depth grows with the turns; the life is given in hours."""
    life = jc.wear_life(problem(wearing_ring(slope=0.0)), hours=1e3 * TURN / 3600)
    assert life.cycles[-1] == pytest.approx(1e3)
    depth = life.at_end("depth")
    ahead = life.cycles_ahead("depth", 4 * depth)
    assert ahead == pytest.approx(3e3, rel=1e-3)
    sentence = life.until("depth", 4 * depth).sentence
    assert f"about 4e+03 cycles ({4e3 * TURN / 3600:.2g} h at {1 / TURN:.4g} Hz)" in sentence
    assert life.cycles_ahead("depth", 0.5 * depth) == np.inf


def test_a_life_ends_where_its_cycles_fail():
    """With what was reached and why: near the depth at which the load breaks."""
    life = jc.wear_life(problem(wearing_ring(slope=0.0, breaks=3e-6)), cycles=1e6)
    assert life.ended.startswith("the run of a cycle ended early")
    assert "ended before its 1e+06 cycles" in life.sentence()
    depth = life.over_life("depth")[-1]
    # The contact lies 1e-6 m deep.
    assert depth == pytest.approx(2e-6, rel=0.1)
    assert life.cycles[-1] == pytest.approx(1e6 * depth / 2.5e-5, rel=0.01)
    assert "does not reach 1" in life.until("depth", 1.0).sentence


@pytest.mark.slow
def test_a_bearing_worn_through_ends_its_life():
    """A wall as deep as its radius is none."""
    life = jc.wear_life(problem(wearing_ring(slope=0.0)), cycles=1e12, accuracy=0.3)
    assert life.ended.startswith('Worn through: the bearing of "B"') and "radius of 0.01 m" in str(
        life
    )
    assert 0.5 * RADIUS < life.at_end("depth") < RADIUS


def test_table_figure_and_dataset_tell_the_life(lived):
    life = lived.life()
    table = life.table()
    assert list(table["cycles"]) == list(life.cycles)
    assert {"depth [m]", "volume B bearing [m^3]", "force [N]", "error of depth"} <= set(table)
    figure = plot.wear_life(life)
    assert_complete(figure)
    assert f"from {life.simulated} simulated ones" in figure.get_suptitle()
    data = life.to_dataset()
    np.testing.assert_array_equal(data["B.bearing.worn"][-1], life.worn()["B"]["bearing"])
    again = jc.steady_cycle(problem(life.problem.mechanism, state=life.state()))
    assert again.responses["force"][0] == pytest.approx(life.over_life("force")[-1], rel=1e-3)


def test_derivatives_of_a_life_are_those_of_the_closed_form():
    """Life is in proportion to hardness; by the load it is so but for the contact's compliance."""
    law, limit = ClosedForm(), 4e-6
    asked = problem(wearing_ring())
    life = jc.wear_life(asked, cycles=1.2 * law.turns(limit))
    found = jc.wear_life_derivatives(life, "depth", limit)
    stiff = 1 / (1 + FORCE * SLOPE / STIFFNESS)
    wanted = {"hardness": law.turns(limit) / 2e9, "load": -law.turns(limit) / FORCE * stiff}
    for name, exact in wanted.items():
        assert abs(found[name].value - exact) < found[name].error < 0.1 * abs(exact), name
        assert f"of {name}" in found[name].sentence
    assert found["load"].unit == "cycles/N"
    with pytest.raises(ValueError, match="Ask for a longer life"):
        jc.wear_life_derivatives(life, "depth", 1.0)


def test_lives_of_a_sample_are_those_of_the_closed_form(tmp_path):
    """Each with its own hardness and load; asked again, the study takes them from its store."""
    law, limit = ClosedForm(), 4e-6
    asked, turns = problem(wearing_ring()), 1.3 * law.turns(limit)
    found = jc.wear_life_sample(asked, 4, cycles=turns, store=tmp_path / "lives")
    assert not found.ended and not found.warned and "4 lives, 0 ended early" in str(found)
    hardness, load = found.values.T

    def compliance(force):
        return 1 / (force * SLOPE) + 1 / STIFFNESS

    wanted = law.turns(limit) * hardness / 2e9 * compliance(load) / compliance(FORCE)
    assert np.ptp(wanted) > 0.05 * law.turns(limit)
    for life, cycles, exact in zip(found.lives, found.until("depth", limit), wanted, strict=True):
        assert abs(cycles - exact) < life.until("depth", limit).error
    assert np.isinf(found.until("depth", 1.0)).all()
    table = found.table()
    assert len(table) == 4 and {"hardness", "load", "cycles", "depth [m]", "ended"} <= set(table)
    again = jc.wear_life_sample(asked, 4, cycles=turns, store=tmp_path / "lives")
    np.testing.assert_array_equal(again.until("depth", limit), found.until("depth", limit))
    other = jc.wear_life_sample(asked, 1, cycles=turns, seed=1, store=tmp_path / "lives")
    assert other.until("depth", limit)[0] not in found.until("depth", limit)


@pytest.mark.slow
def test_a_life_is_a_response_as_any_other(tmp_path, monkeypatch):
    """As long as it takes, in proportion to hardness over load where the force does not fall. A
    study that is interrupted in its second life goes on from the cycle before."""
    life = {"life": jc.LifeUntil("depth", 1e-5), "sure": jc.LifeUntil("depth", 1e-5, sure=True)}
    asked = jc.LifeProblem(problem(wearing_ring(slope=0.0)), life)
    simulate, done, ends = rates.cycle, [], [3]

    def counted(*args):
        if len(done) == ends[0]:
            raise KeyboardInterrupt
        done.append(1)
        return simulate(*args)

    monkeypatch.setattr(rates, "cycle", counted)
    with pytest.raises(KeyboardInterrupt, match="kept in .*kept; ask the same again"):
        jc.monte_carlo(asked, 2, store=tmp_path / "kept")
    ends[0] = -1
    found = jc.monte_carlo(asked, 2, store=tmp_path / "kept")
    together = len(done)
    plain = jc.monte_carlo(asked, 2)
    alone = len(done) - together
    # A cycle that comes twice is computed once.
    assert 0.5 * alone < together <= alone
    again = jc.monte_carlo(asked, 2, store=tmp_path / "kept")
    assert len(done) == together + alone
    for one in (plain, again):
        assert str(one) == str(found)
        np.testing.assert_array_equal(one.responses["life"], found.responses["life"])
    hardness, load = found.values.T
    way = 2 * np.pi * (RADIUS + 0.5 * load / STIFFNESS)
    wanted = 1e-5 * 2 * np.pi * RADIUS * LENGTH * hardness / (1e-5 * load * way)
    # Cells are as deep as their mean to a few 1e-4, in the few losses in which they are worn.
    np.testing.assert_allclose(found.responses["life"], wanted, rtol=3e-4)
    assert np.all(found.responses["sure"] < found.responses["life"])
    assert found.problem.units()["life"] == "cycles" and np.ptp(wanted) > 0.01 * wanted[0]
    assert found.rerun(1).until("depth", 1e-5).cycles == found.responses["life"][1]


def lived_through(*given, rig=None, **how):
    """A life of the ring's problem, or of a mechanism."""
    return jc.wear_life(problem(wearing_ring()) if rig is None else rig, *given, **how)


FAST = eqx.tree_at(
    lambda r: r.connections["B"].joint.bearing_wear.acceleration, wearing_ring(), jnp.asarray(50.0)
)
CRANK = jc.scenes.slider_crank()
test_what_cannot_be_asked_is_refused = refusals(
    {
        "nothing wears": lambda: lived_through(rig=CRANK, period=2 * np.pi / 50, cycles=9),
        "cycles of wear_life is -1": lambda: lived_through(cycles=-1),
        r"wear_life.* at most 9\.0072e\+15": lambda: lived_through(cycles=1e300),
        r"at most 9\.0072e\+15": lambda: jc.wear_life_sample(problem(wearing_ring()), cycles=1e300),
        "jump of wear_life is 0.5": lambda: lived_through(jump=0.5),
        "must be the path of a folder": lambda: lived_through(store=3),
        r"needs its period \[s\]": lambda: lived_through(rig=wearing_ring()),
        "a period of .* and no number of cycles": lambda: lived_through(TURN, rig=wearing_ring()),
        "leave one of them out": lambda: lived_through(cycles=9, hours=9),
        "hours of wear_life is -1": lambda: lived_through(hours=-1.0),
        "give cycles by name, cycles=": lambda: lived_through(1e6),
        "acceleration=50; wear_life carries wear on by itself": lambda: lived_through(
            rig=FAST, period=TURN, cycles=9
        ),
    }
)


# The steps alone: one cell whose rate is known, and its volume.
ONE = Cells((slice(0, 1),), np.ones(1))


def alone(evaluate):
    """A machine of one cell, worn in proportion to its losses."""
    one = lambda job: job.row + job.share * sum(n * rate.wear for n, rate in job.losses)
    carry = lambda jobs: [one(job) for job in jobs]
    machine = Machine(evaluate, carry, ONE)
    return machine, Node.first(np.zeros(2), evaluate(np.zeros(2)), ONE)


def stepped(rate, turns, tolerance, noise=0.0, seed=0):
    """Steps over a rate of one cell with relative noise."""
    rng = np.random.default_rng(seed)

    def evaluate(depth):
        exact = rate(depth)
        return Rate(exact * (1 + noise * rng.normal()), noise * exact, 1)

    machine, start = alone(evaluate)
    return live(machine, start, turns, tolerance, 0.25 * turns)


def test_steps_are_of_third_order():
    """A tolerance a thousand times smaller, steps ten times shorter."""
    counts = []
    for tolerance in (1e-4, 1e-7):
        found = stepped(lambda h: 1e-6 / (1 + h), 1e6, tolerance)
        error = found.nodes[-1].depth[0] / (np.sqrt(3.0) - 1) - 1
        assert abs(error) < tolerance
        counts.append(len(found.nodes))
    assert counts[1] / counts[0] == pytest.approx(10.0, rel=0.3)


def bound_of(node):
    """What is told of the error of a depth: that of the steps and 95 % of the noise."""
    return node.error[0] + 1.96 * np.sqrt(node.variance[0])


def test_noise_takes_no_steps_back_and_belongs_to_the_error():
    """Rates known to 3 %: the error told covers the true one in 95 of 100 lives."""
    covered = []
    for seed in range(100):
        found = stepped(lambda h: 1e-6 / (1 + h), 1e6, 1e-2, noise=0.03, seed=seed)
        last = found.nodes[-1]
        assert found.rejected <= 2 and len(found.nodes) < 10
        covered.append(abs(last.depth[0] - (np.sqrt(3.0) - 1)) < bound_of(last))
    assert np.mean(covered) > 0.9


def test_scatter_that_no_step_mends_is_told_not_fought():
    """Rates that scatter by 2 % about a smooth law without saying so: few steps are taken back, and
    what is told covers the true error in 95 of 100."""
    covered, counts = [], []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        scattered = lambda depth, rng=rng: 1e-6 / (1 + depth) * (1 + 0.02 * rng.normal())
        found = stepped(scattered, 1e6, 1e-3)
        last = found.nodes[-1]
        counts.append(len(found.nodes) + found.rejected)
        covered.append(abs(last.depth[0] - (np.sqrt(3.0) - 1)) < bound_of(last))
    assert max(counts) < 50 and np.median(counts) < 12 and np.mean(covered) >= 0.95


LAWS = {
    "exponential": (lambda h: 1 - h, 1 - np.exp(-1.0)),
    "square root": (lambda h: 1 / (1 + h), np.sqrt(3.0) - 1),
    "cube root": (lambda h: (1 + h) ** -2, 4 ** (1 / 3) - 1),
    "fifth root": (lambda h: (1 + h) ** -4, 6**0.2 - 1),
    "two thirds": (lambda h: (1 + h) ** -0.5, 2.5 ** (2 / 3) - 1),
    "growing": (lambda h: 1 + h, np.e - 1),
}


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("tolerance", [3e-3, 1e-3, 1e-4])
def test_the_error_told_is_one_to_five_times_the_true_one(law, tolerance):
    """Whatever the law by which the rate follows the depth."""
    rate, exact = LAWS[law]
    last = stepped(lambda h: 1e-6 * rate(h), 1e6, tolerance).nodes[-1]
    true = abs(last.depth[0] - exact)
    assert 1.0 < last.error[0] / true < 5.0
    assert bound_of(last) < 5.0 * max(true, tolerance * exact)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4])
@pytest.mark.parametrize("turns", [1e8, 1e12, 9e15])
def test_wear_that_comes_to_an_end_costs_no_steps(turns, tolerance):
    """Steps of a rate that dies away would never grow if their errors were shares of what they wear
    themselves; what is told holds the true depth."""
    found = stepped(lambda h: 1e-6 * np.maximum(1 - h, 0.0), turns, tolerance)
    last = found.nodes[-1]
    assert last.cycles == pytest.approx(turns) and not found.ended
    assert len(found.nodes) + found.rejected < 120
    assert abs(last.depth[0] - 1.0) <= bound_of(last) < 3 * tolerance


def test_a_stiff_scar_is_followed_one_by_one_and_jumps_as_they_are_asked():
    """Where the rate answers within two cycles."""
    found = stepped(lambda h: 0.5 * (1 - h), 30.0, 1e-3)
    assert found.nodes[-1].depth[0] == pytest.approx(1.0, abs=1e-6)
    assert max(np.diff([node.cycles for node in found.nodes])) <= 8
    machine, start = alone(lambda depth: Rate(1e-6 * np.ones(2), np.zeros(2), 1))
    found = live_by_jumps(machine, start, 1e6, 3e5)
    assert [node.cycles for node in found.nodes] == [0.0, 3e5, 6e5, 9e5, 1e6]
    assert found.nodes[-1].depth[0] == pytest.approx(1.0)
