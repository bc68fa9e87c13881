"""What a run says of wear that its parts or its saving times leave wrong: a pin that only swings in
a bush, both of which wear, beside the area between two circles; and paths between saving times."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators.checks import Check
from tests.rigs.cells import slow
from tests.rigs.wearing_ring import wearing_ring
from tests.rigs.worn_scar import TURN, crescent, depth_of, lost, scar

CLEARANCE, CELLS, LOSS = 1e-4, 72, crescent(30e-6, 1e-4)


def worn_over(turns, journal=True):
    """The run in which each worn part loses the same volume over so many turns of the pin."""
    rig = scar(CLEARANCE, CELLS, journal).mechanism
    factor = jnp.asarray(LOSS / (turns * lost(CLEARANCE)))
    surfaces = ("bearing_wear", "journal_wear") if journal else ("bearing_wear",)
    where = lambda rig: [getattr(rig.connections["B"].joint, s).acceleration for s in surfaces]
    rig = eqx.tree_at(where, rig, [factor] * len(surfaces))
    step = jc.integrator.NonColliding(turns * TURN / 96)
    return jc.simulate(rig, turns * TURN, save=25, integrator=step, verify=False)


def test_a_pin_that_only_swings_says_how_much_too_deep_its_scars_are():
    """Both lose half of one crescent, as they conform: as a check tells, its depth is a fifth less
    than that of a crescent of one volume each."""
    run = worn_over(0.03)
    volumes = [float(run.worn_volume("B", s)[-1]) for s in ("bearing", "journal")]
    found = max(float(np.max(run.worn["B"][s])) for s in ("bearing", "journal"))
    true = 0.5 * depth_of(sum(volumes), CLEARANCE)
    figure = float(np.max(run.invariants.figures[Check.BOTH_WORN].worst))
    assert Check.BOTH_WORN.limit < (found - true) / found <= 1.1 * figure
    assert figure < 0.25
    assert any("parts of joint" in sentence for sentence in run.warnings)


@pytest.mark.parametrize("journal", [True, False])
def test_a_pin_that_turns_round_or_does_not_wear_says_nothing(journal):
    run = worn_over(3.0, journal)
    assert (Check.BOTH_WORN in run.invariants.figures) == journal
    assert not any("parts of joint" in sentence for sentence in run.warnings)


@pytest.mark.parametrize(("saves", "cells"), [(19, 2.0), *slow((73, 0.5))])
def test_counted_steps_say_how_far_contacts_move_between_updates(saves, cells):
    """A turn over 36 cells."""
    rig, turn = wearing_ring(), 0.05
    step = jc.integrator.ImplicitStep(steps_per_save=720 // saves)
    run = jc.simulate(rig, turn, save=saves, integrator=step, verify=False)
    figure = float(run.invariants.figures[Check.WEAR_AT_SAVES].worst[0])
    assert figure == pytest.approx(cells, rel=0.2)
    said = any("whose steps are counted wears at these" in sentence for sentence in run.warnings)
    assert said == (cells > 1)


def test_runs_that_wear_whenever_a_contact_has_moved_have_no_such_figure():
    run = worn_over(0.03, journal=False)
    assert Check.WEAR_AT_SAVES not in run.invariants.figures
