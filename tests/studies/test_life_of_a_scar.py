"""The life of a bearing into which a pin is pressed one way: the volume that it loses in a turn
stays, its scar widens, so its depth slows. By the area between two circles."""

import numpy as np
import pytest

import jaxclear as jc
from tests.rigs.cells import slow
from tests.rigs.worn_scar import TURN, crescent, depth_of, lost, scar

CLEARANCE, CYCLES = 0.05e-3, 1e4


@pytest.fixture(scope="module")
def life():
    return jc.wear_life(scar(CLEARANCE, 288), cycles=CYCLES, accuracy=2e-2)


def test_the_volume_of_a_cycle_stays_to_rounding_while_depth_slows(life):
    each = [stage.settled.last.volumes["B"]["bearing"] for stage in life.stages[1:]]
    np.testing.assert_allclose(each, lost(CLEARANCE), rtol=1e-9)
    places = np.array([0.1, 0.2, 0.4, 0.8, 1.0]) * CYCLES
    depths = np.array([float(life.over_life("depth", n)) for n in places])
    wanted = [depth_of(n * lost(CLEARANCE), CLEARANCE) for n in places]
    # A cell of 1.25 degrees is the mean over its width, of a scar of 20 to 50; and a contact is at
    # least two cells wide.
    np.testing.assert_allclose(depths, wanted, rtol=0.05)
    rates = np.diff(depths) / np.diff(places)
    assert np.all(np.diff(rates) < 0) and rates[-1] < 0.7 * rates[0]


def test_a_life_knows_what_the_clearance_does_to_it(life):
    """More clearance is a narrower scar, which is as deep sooner: by the two circles."""
    limit = 0.7 * float(life.over_life("depth")[-1])
    found = jc.wear_life_derivatives(life, "depth", limit)["clearance"]
    step = 1e-7
    more, less = (crescent(limit, c) / lost(c) for c in (CLEARANCE + step, CLEARANCE - step))
    exact = (more - less) / (2 * step)
    assert abs(found.value - exact) < found.error < 0.1 * abs(exact)
    assert found.value == pytest.approx(exact, rel=0.05) and found.unit == "cycles/m"


@pytest.mark.parametrize("clearance", [*slow(100e-6, 50e-6), 25e-6])
def test_a_tight_bushing_costs_no_more_cycles_than_a_wide_one(clearance):
    """Down to five times the clearance: levelling between cells is stiff, and was followed by
    thousands of cycles. Lives in fifty jumps and in half as many, which are of first order and so
    extrapolated, are not further off than is told."""
    depth, asked = 127e-6, scar(clearance, 36)
    turns = crescent(depth, clearance) / lost(clearance)
    life = jc.wear_life(asked, cycles=turns)
    assert life.simulated <= 20 and life.error < 5e-3 and not life.warnings
    # 36 cells of 10 degrees, of a scar of 76 to 161.
    assert life.at_end("depth") == pytest.approx(depth, rel=0.05)
    assert life.at_end("volume") == pytest.approx(turns * lost(clearance), rel=1e-9)
    jumps = (jc.wear_life(asked, cycles=turns, jump=turns / count) for count in (50, 25))
    mine, fine, coarse = (each.worn()["B"]["bearing"] for each in (life, *jumps))
    exact = 2 * fine - coarse
    off = np.sqrt(np.mean((mine - exact) ** 2) / np.mean(exact**2))
    assert off < life.error < 20 * off


@pytest.mark.parametrize("cells", [16, 288])
def test_a_life_whose_scar_is_hardly_wider_than_a_cell_says_so_as_a_run_does(cells):
    """At its end the scar is 22 degrees wide, a cell of sixteen 22.5. In a new wall, of which a run
    of one turn tells, every scar is narrow."""
    asked = scar(CLEARANCE, cells)
    cycles = crescent(1e-6, CLEARANCE) / lost(CLEARANCE)
    life = jc.wear_life(asked, cycles=cycles, accuracy=0.2)
    how = {"save": 25, "integrator": asked.integrator, "verify": False}
    run = jc.simulate(asked.mechanism, TURN, **how)
    warned = [any("hardly wider than a cell" in one for one in own.warnings) for own in (life, run)]
    assert warned == [cells == 16, True]


@pytest.mark.slow
def test_a_verified_life_states_the_error_of_its_cells():
    """18 cells of a scar of 10; the closed form is the area between two circles."""
    depth = 127e-6
    turns = crescent(depth, CLEARANCE) / lost(CLEARANCE)
    life = jc.wear_life(scar(CLEARANCE, 18), cycles=turns, verify=True)
    off = abs(life.at_end("depth") / depth - 1)
    assert 0.5 * off < life.error < 5 * off
    assert "That of cells" not in life.sentence()
    unverified = jc.wear_life(scar(CLEARANCE, 18), cycles=turns)
    assert unverified.by_cells is None and unverified.error < life.error
