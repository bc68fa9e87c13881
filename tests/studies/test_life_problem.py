"""Lives as responses, against Archard's law at a constant load: every cell of a ring wears alike,
so a life is in proportion to hardness over load, and what a design may allot has a closed form."""

import threading
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import jaxclear as jc
from jaxclear.integrators import Outcome
from jaxclear.studies.experiment import Cost
from jaxclear.studies.life.life_problem import LifeExperiment
from jaxclear.studies.store.batch import evaluate_all
from tests.rigs.refusals import refusals
from tests.rigs.wearing_ring import FORCE, HARDNESS, LENGTH, RADIUS, STIFFNESS, WEAR, wearing_ring
from tests.rigs.wearing_ring import problem as one_turn

LIMIT = 1e-5


def closed_form(hardness, load):
    """Turns until the wall is worn by `LIMIT`."""
    return LIMIT * LENGTH * hardness / WEAR / load / (1 + 0.5 * load / STIFFNESS / RADIUS)


@pytest.fixture(scope="module")
def asked():
    response = {
        "life": jc.LifeUntil("depth", LIMIT),
        "sure": jc.LifeUntil("depth", LIMIT, sure=True),
    }
    return jc.LifeProblem(one_turn(wearing_ring(slope=0.0)), response)


@pytest.mark.slow(sample=False)
def test_a_life_that_never_reaches_its_limit_is_infinite_and_loses_no_other(asked):
    """A load that falls to nothing at half the depth. What has no machine has failed."""
    both = {"life": jc.LifeUntil("depth", LIMIT), "near": jc.LifeUntil("depth", 0.1 * LIMIT)}
    short = jc.LifeProblem(one_turn(wearing_ring(slope=2e5)), both)
    found = short.evaluate(short.nominal())
    assert found.outcome == Outcome.REACHED
    assert np.isposinf(found.responses["life"]) and 0 < found.responses["near"] < found.ended
    lost = asked.evaluate(np.array([-1e9, FORCE]))
    assert lost.outcome == Outcome.OUT_OF_RANGE and np.isnan(lost.responses["life"])
    assert jax.tree.structure(found.checks) == jax.tree.structure(lost.checks)


def at_end(life):
    return life.at_end("depth")


@pytest.fixture(scope="module")
def followed():
    """Lives that scatter about the nominal one, which is as long as they are followed."""
    wanted = {
        "life": jc.LifeUntil("depth", LIMIT),
        "sure": jc.LifeUntil("depth", LIMIT, sure=True),
        "worn": at_end,
    }
    nominal = closed_form(HARDNESS, FORCE)
    return jc.LifeProblem(one_turn(wearing_ring(slope=0.0)), wanted, cycles=nominal)


@pytest.mark.slow(sample=False)
def test_lives_longer_than_they_are_followed_count_on_their_side_and_have_no_mean(followed):
    """Each is told apart by the closed form; a limit beyond what is followed is refused."""
    nominal = followed.cycles
    found = jc.monte_carlo(followed, 8)
    exact = closed_form(*found.values.T)
    longer = exact > nominal
    assert 2 <= longer.sum() <= 6 and not len(found.failed)
    np.testing.assert_array_equal(np.isposinf(found.responses["life"]), longer)
    # Cells differ by 1e-4 of a turn's depth, and the deepest place between them is what counts.
    np.testing.assert_allclose(found.responses["life"][~longer], exact[~longer], rtol=2e-4)
    assert np.all(found.responses["sure"] <= found.responses["life"])
    assert np.isfinite(found.mean("worn").value)
    within = found.share_within({"life": (0.9 * nominal, None)})
    assert within.value == np.mean(exact >= 0.9 * nominal)
    assert found.quantile("life", 0.1).value < nominal < found.quantile("life", 0.99).value
    assert found.quantile("life", 0.99).error == np.inf
    told = f'"life" is infinite in {longer.sum()} of 8 samples (its limit is not reached within'
    assert told in found.sentence()
    for ask in (found.mean, found.standard_deviation, found.error_budget):
        with pytest.raises(ValueError, match=r"infinite in .* ask for a quantile, or"):
            ask("life")
    row = found.summary({"life": (0.9 * nominal, None)}).set_index("response").loc["life"]
    assert np.isnan(row["mean"]) and np.isnan(row["Cpk"]) and row["infinite"] == longer.sum()
    assert row["failed"] == 0 and np.isfinite(row["5 %"])
    with pytest.raises(ValueError, match=r"told up to .* not reached within"):
        found.share_within({"life": (1.1 * nominal, None)})


def test_limits_beyond_what_lives_are_followed_for_are_refused(followed):
    beyond = 2 * followed.cycles
    with pytest.raises(ValueError, match="told up to"):
        jc.reliability(followed, jc.limit_state.Below("life", beyond))
    costs = {"hardness": jc.cost.Reciprocal(1.0)}
    for limit in (
        jc.limit.Quantile("life", at_least=beyond, share=0.9),
        jc.limit.Probability("life", below=beyond, at_most=0.01),
    ):
        with pytest.raises(ValueError, match="told up to"):
            jc.design(followed, costs, limit, tolerance={"hardness": (1e7, 4e8)})


def test_values_that_no_machine_has_are_failed_lives_as_they_are_failed_runs(asked):
    """Also where only the end of a life is asked for, which any hardness has a number for."""
    end = jc.LifeProblem(asked.problem, at_end, cycles=1e4)
    for problem in (asked, end):
        found = problem.evaluate(np.array([-1e9, FORCE]))
        assert found.outcome == Outcome.OUT_OF_RANGE and found.outcome.dtype.kind == "i"
        assert np.isnan(found.responses[problem.response_names[0]])
    with pytest.raises(ValueError, match="hardness = -1"):
        end.detail(np.array([-1e9, FORCE]))


@pytest.mark.slow(sample=False)
def test_values_of_which_no_machine_can_be_put_together_are_told_so():
    """A coupler that is too short to reach the follower, as it is of runs."""
    where = lambda rig: rig.connections["B"].parent.at[0]
    turn = jc.Problem(
        jc.scenes.four_bar("planar", cells=(36, 1)),
        jc.response.MeanContactForce("B"),
        {"coupler": jc.Variable(where, jc.distribution.Uniform(0.35))},
        duration=0.2 * np.pi,
        save=73,
        integrator=jc.integrator.FixedStep(2e-5, "semi_implicit"),
    )
    lives = jc.LifeProblem(turn, jc.LifeUntil("depth", LIMIT))
    found = lives.evaluate(np.array([0.06]))
    assert found.outcome == Outcome.UNASSEMBLED and np.isnan(found.responses["response"])
    assert lives.description.ending(found.outcome, 0.0).startswith("the mechanism cannot be assem")


def test_warnings_of_shapes_are_none_of_the_volume(asked):
    wanted = {"deep": jc.LifeUntil("depth", LIMIT), "lost": jc.LifeUntil("volume", 1e-9)}
    lives = jc.LifeProblem(asked.problem, wanted)
    parts = {name: own.depends_on for name, own in lives.description.responses.items()}
    assert "worn depth" in parts["deep"] and "worn depth" not in parts["lost"]
    for name in wanted:
        assert "motion" in parts[name]


def test_a_life_whose_error_is_unknown_is_told_and_nothing_of_it_is_sure():
    until = SimpleNamespace(cycles=1e6, error=np.inf)
    life = SimpleNamespace(until=lambda name, limit: until)
    assert jc.LifeUntil("depth", LIMIT)(life) == 1e6
    assert jc.LifeUntil("depth", LIMIT, sure=True)(life) == 0.0


def test_a_response_of_a_life_that_returns_nothing_is_told_so(asked, monkeypatch):
    lives = jc.LifeProblem(asked.problem, lambda life: None, cycles=10)
    monkeypatch.setattr(LifeExperiment, "life", lambda self, values: SimpleNamespace(ended=""))
    with pytest.raises(ValueError, match="is a `return` missing"):
        lives.evaluate(asked.nominal())


def test_lives_are_lived_one_after_the_other_in_the_thread_that_asks():
    class Own:
        def cost(self):
            return Cost(0, 1, compiled=False)

        def evaluate(self, values):
            return values[0], np.asarray(threading.get_ident())

    values = np.arange(4.0)[:, None]
    found, threads = evaluate_all(Own(), values)
    np.testing.assert_array_equal(found, values[:, 0])
    assert set(threads) == {threading.get_ident()}


UNTIL = jc.LifeUntil("depth", 1e-5)
CYCLE = one_turn(wearing_ring(slope=0.0))
test_what_cannot_be_asked_of_lives_is_refused = refusals(
    {
        '^(?!.*"b").*needs cycles=, how long': lambda: jc.LifeProblem(CYCLE, at_end),
        "needs cycles=": lambda: jc.LifeProblem(CYCLE, lambda life: life.error),
        '"b" .* needs cycles=, how long a life is': lambda: jc.LifeProblem(
            CYCLE, {"a": UNTIL, "b": at_end}
        ),
        'no quantity "deep"': lambda: jc.LifeProblem(CYCLE, jc.LifeUntil("deep", 1e-5)),
        "of one cycle": lambda: jc.LifeProblem(CYCLE.mechanism, UNTIL),
        "LifeProblem is -1": lambda: jc.LifeProblem(CYCLE, UNTIL, cycles=-1),
    }
)


@pytest.mark.slow(sample=False)
def test_a_design_for_life_allots_tolerances_as_the_closed_form():
    """Reciprocal costs of the tolerances x of hardness and y of load, as shares: the worst machine
    lives (1 - x) / (1 + y) of the nominal life. Verified by runs, sure of the life's own error."""
    life = {"life": jc.LifeUntil("depth", LIMIT, sure=True)}
    lives = jc.LifeProblem(one_turn(wearing_ring(slope=0.0)), life)
    share, prices = 0.9, {"hardness": 1.0, "load": 4.0}
    sizes = {"hardness": HARDNESS, "load": FORCE}
    found = jc.design(
        lives,
        {name: jc.cost.Reciprocal(price * sizes[name]) for name, price in prices.items()},
        jc.limit.WorstCase("life", at_least=share * closed_form(HARDNESS, FORCE)),
        tolerance={name: (0.005 * size, 0.2 * size) for name, size in sizes.items()},
        settings=jc.DesignSettings(runs=24, check=16, samples=64),
    )
    other = lambda x: (1 - x) / share - 1
    best = minimize_scalar(
        lambda x: 1.0 / x + 4.0 / other(x), bounds=(1e-3, 1 - share - 1e-3), method="bounded"
    )
    assert found.holds and found.cost == pytest.approx(best.fun, rel=0.01)
    assert found.tolerances["hardness"] / HARDNESS == pytest.approx(best.x, rel=0.05)
    # A cycle more of the limit costs what it takes from both.
    assert found.unit(0) == "cycles" and "saves" in found.sentence()


@pytest.mark.slow(sample=False)
def test_derivatives_of_the_mean_life_are_those_of_the_closed_form(asked):
    found = jc.sensitivity(asked, sample=32, difference_samples=8)
    hardness = found.derivatives["life", "hardness"]
    assert hardness.trustworthy
    exact = closed_form(1.0, FORCE)
    assert hardness.value == pytest.approx(exact, abs=hardness.error + 0.01 * exact)
    assert found.unit("life", "hardness") == "cycles/Pa"


def test_slopes_and_campaigns_of_lives_are_refused_with_what_serves(asked, tmp_path):
    """Before a file is written."""
    with pytest.raises(ValueError, match="jaxclear.wear_life_derivatives"):
        jax.grad(lambda values: asked.evaluate(values).responses["life"])(asked.nominal())
    with pytest.raises(ValueError, match=r"no compiled program.*monte_carlo.*wear_life_sample"):
        jc.campaign(asked, folder=tmp_path / "kept")
    assert not any(tmp_path.iterdir())


@pytest.mark.slow(sample=False)
def test_a_campaign_of_wearing_runs_is_the_plain_study_bit_for_bit(tmp_path):
    """Its checks too; read again, it is the same."""
    turn = one_turn(wearing_ring(slope=0.0))
    plain, found = jc.monte_carlo(turn, 4), jc.campaign(turn, 4, folder=tmp_path)
    for kept in (found, jc.open_campaign(tmp_path)):
        assert kept.is_complete
        for name, own in plain.responses.items():
            assert np.array_equal(own, kept.responses[name])
        assert kept.warnings() == plain.warnings()
        assert kept.sentence() == plain.sentence()
    assert np.all(plain.responses["peak depth"] > 0)
