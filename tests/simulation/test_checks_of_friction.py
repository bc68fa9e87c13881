"""A run says so where its steps do not resolve friction: what loaded bearings lose is then off."""

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators import Check
from tests.rigs.loaded_bearing import loaded_bearing, losses

DURATION, SAVES = 0.01, 41
TIGHT = jc.integrator.Adaptive(rtol=1e-8, atol=1e-12)
FRICTION = {Check.FRICTION_STEP, Check.CREEP_STEP}
# Off by more than this a run is to say so.
WRONG = 0.02


def run_of(rig, integrator, duration=DURATION, save=SAVES, **options):
    return jc.simulate(rig, duration, integrator=integrator, save=save, **options)


def said(run):
    """Whether a warning concerns wear."""
    return any(w > c.limit and c.concerns in ("wear", "motion") for c, w, *_ in run.checks.rows())


def off(rig, run):
    """How far friction loss is off beside a tight run."""
    return abs(losses(run)[0] / losses(run_of(rig, TIGHT, balance=True))[0] - 1)


@pytest.mark.parametrize(
    "load", [*(pytest.param(load, marks=pytest.mark.slow) for load in (20.0, 100.0)), 500.0]
)
@pytest.mark.parametrize(
    ("integrator", "kind"),
    [
        (jc.integrator.FixedStep(), Check.FRICTION_STEP),
        (jc.integrator.ImplicitStep(), Check.CREEP_STEP),
    ],
)
def test_steps_that_lose_too_much_where_a_journal_creeps_say_so(integrator, kind, load):
    """Explicit steps of 2e-5 s carry slip past rest, back and forth; implicit ones of 1e-4 s miss
    the vibration that lets a journal creep. Both reached the end without a word."""
    rig = loaded_bearing(load, jc.friction.Stribeck())
    run = run_of(rig, integrator, balance=True)
    assert off(rig, run) > WRONG
    assert kind in {c for c, w, *_ in run.checks.rows() if w > c.limit}
    assert 'oint "B"' in run.result and said(run)


@pytest.mark.parametrize("load", [100.0, 500.0])
def test_steps_that_resolve_friction_say_nothing_of_it(load):
    """Explicit steps on a journal that slides; implicit ones, short enough, on one that creeps."""
    sliding = loaded_bearing(load, jc.friction.Stribeck(), sliding=True)
    explicit = run_of(sliding, jc.integrator.FixedStep(), balance=True)
    creeping = loaded_bearing(load, jc.friction.Stribeck())
    implicit = run_of(creeping, jc.integrator.ImplicitStep(2e-5, rebound=1.0), balance=True)
    for rig, run in ((sliding, explicit), (creeping, implicit)):
        assert off(rig, run) < WRONG
        assert not said(run)
        # A second look that finds the steps right drops what speaks of them.
        assert (FRICTION | {Check.MEAN_FORCE}) & set(run.checks.figures)


@pytest.mark.slow
def test_friction_that_explicit_steps_resolve_is_not_said():
    """A step stops an eighth of the slip, all the time: rk4 is right, and was said to be off."""
    rig = loaded_bearing(20.0, jc.friction.CoulombTanh(transition_speed=1e-3))
    run = run_of(rig, jc.integrator.FixedStep(), balance=True)
    assert off(rig, run) < WRONG and not said(run)
    long = run_of(rig, jc.integrator.FixedStep(2e-4), balance=True)
    assert off(rig, long) > WRONG and said(long)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["semi_implicit", "munthe_kaas4"])
def test_every_explicit_method_says_so(method):
    run = run_of(
        loaded_bearing(500.0, jc.friction.Stribeck()), jc.integrator.FixedStep(method=method)
    )
    assert run.checks.beyond()[Check.FRICTION_STEP]


@pytest.mark.slow
def test_short_steps_in_contact_are_judged_by_their_own_length():
    rig = loaded_bearing(100.0, jc.friction.Stribeck())
    figure = lambda **how: float(
        run_of(rig, jc.integrator.FixedStep(**how)).checks.figures[Check.FRICTION_STEP].worst[0]
    )
    assert np.isclose(figure(contact_steps=20), figure(step=1e-6), rtol=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene", ["slider_crank", pytest.param("four_bar", marks=pytest.mark.slow)]
)
def test_scenes_in_the_steps_of_studies_say_nothing_of_friction(scene):
    run = run_of(getattr(jc.scenes, scene)(), jc.integrator.FixedStep(), 0.2, 201)
    assert float(run.checks.figures[Check.FRICTION_STEP].worst.max()) < Check.FRICTION_STEP.limit


def test_mechanisms_that_do_not_rub_have_no_figure_of_friction():
    run = run_of(jc.scenes.slider_crank(friction=False), jc.integrator.FixedStep(), duration=0.002)
    assert not FRICTION & set(run.checks.figures)
