"""Lanes of cycles of a motion that does not settle: what their means tell, and lives by them."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.studies.life import rates
from jaxclear.studies.life.cycle import asked_of, cycle, cycles, first_state
from jaxclear.studies.life.settling import Patience, settle_side_by_side

LANES, ALIKE = 8, 0.6


def restless(rng, fault_at=None):
    """Cycles side by side whose wear about 1 is alike from one to the next of a lane."""
    count = [0]

    def run(begins, worn):
        count[0] += 1
        found = []
        for begin in begins:
            end = ALIKE * begin + math.sqrt(1 - ALIKE**2) * rng.normal()
            own = {"B": {"bearing": np.array([1 + 0.1 * end])}}
            fault = "broken" if count[0] == fault_at else ""
            lost = {"B": {"bearing": 1 + 0.1 * end}}
            found.append(SimpleNamespace(end=end, wore=own, lost=lost, fault=fault, distance=1.0))
        return found

    return run


def settled(rng, known=lambda found: False, most=40, **kwargs):
    begins = list(rng.normal(size=LANES))
    return settle_side_by_side(
        restless(rng, **kwargs), begins, {}, Patience(1e-3, 0.02, most), known
    )


def test_means_of_lanes_tell_how_far_the_mean_of_all_is_known():
    """However much the cycles of a lane are alike: errors summed over stages, as a life sums them,
    hold for some 95 of 100 lives."""
    rng, within = np.random.default_rng(5), 0
    for _ in range(100):
        stages = [settled(rng) for _ in range(6)]
        off = sum(s.wear["B"]["bearing"][0] - 1 for s in stages)
        told = 1.96 * math.sqrt(sum(s.noise["B"]["bearing"][0] ** 2 for s in stages))
        within += abs(off) <= told
    assert within >= 91


def test_first_cycles_of_lanes_are_not_taken_and_patience_is_kept():
    found = settled(np.random.default_rng(0))
    assert len(found.cycles) == 40 and found.measured == 32 and found.lanes == LANES
    assert [one.end for one in found.ends] == [one.end for one in found.cycles[LANES + 3 :: 4]]
    soon = settled(np.random.default_rng(0), known=lambda found: found.measured >= 16)
    assert len(soon.cycles) == 24 and soon.noise["B"]["bearing"][0] > 0
    failed = settled(np.random.default_rng(0), fault_at=2)
    assert failed.last.fault == "broken" and failed.measured == 1


def beating(begins, worn):
    """Cycles of a motion that beats: each lane's next one is that of a lane a cycle ahead."""
    found = []
    for begin in begins:
        lost = 1 + 0.1 * math.sin(0.7 * begin)
        wore, volume = {"B": {"bearing": np.array([lost])}}, {"B": {"bearing": lost}}
        found.append(SimpleNamespace(end=begin + 1, wore=wore, lost=volume, fault="", distance=1.0))
    return found


def test_lanes_that_go_in_file_tell_nothing():
    patience, never = Patience(1e-3, 0.02, 40), lambda found: False
    assert settle_side_by_side(beating, range(LANES), {}, patience, never) is None
    # One that leaves the path of the others after two cycles.
    parted = lambda begins, worn: beating([b + 50 * i * (b >= 3) for i, b in enumerate(begins)], 0)
    found = settle_side_by_side(parted, range(LANES), {}, patience, never)
    assert found.lanes == LANES and found.measured < 32
    far = settle_side_by_side(beating, [100 * i * i for i in range(LANES)], {}, patience, never)
    assert far.lanes == LANES


@pytest.fixture(scope="module")
def rattling():
    rig = jc.scenes.slider_crank(wear=True)
    responses = {"force": jc.response.MeanContactForce("B")}
    return jc.Problem(rig, responses, {}, duration=2 * math.pi / 50)


@pytest.mark.slow
def test_cycles_side_by_side_are_those_alone(rattling):
    """Each from its own state, to what impacts make of rounding."""
    asked = asked_of(rattling, rattling.nominal())
    begin, worn = first_state(rattling, rattling.nominal())
    begins = [begin]
    for _ in range(2):
        begins.append(cycle(asked, begins[-1], worn)[0].end)
    together = cycles(asked, begins, worn)
    for one, start in zip(together, begins, strict=True):
        alone = cycle(asked, start, worn)[0]
        np.testing.assert_allclose(
            one.wore["B"]["bearing"], alone.wore["B"]["bearing"], rtol=1e-3, atol=1e-15
        )
        assert one.checks.figures.keys() == alone.checks.figures.keys() and not one.fault


@pytest.mark.slow
def test_a_life_by_lanes_agrees_with_one_by_single_cycles(rattling, tmp_path, monkeypatch):
    """Within what both tell; begun again, it goes on bit for bit."""
    single = jc.wear_life(rattling, cycles=1e6, accuracy=2e-2, most=rates.LANES * rates.WORTH - 1)
    simulate, left = rates.cycles, [2]

    def interrupted(*args):
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        return simulate(*args)

    monkeypatch.setattr(rates, "cycles", interrupted)
    given = {"accuracy": 2e-2, "most": 40, "store": tmp_path / "life"}
    with pytest.raises(KeyboardInterrupt):
        jc.wear_life(rattling, cycles=1e6, **given)
    left[0] = 1000
    life = jc.wear_life(rattling, cycles=1e6, **given)
    whole = jc.wear_life(rattling, cycles=1e6, accuracy=2e-2, most=40)
    np.testing.assert_array_equal(life.worn()["B"]["bearing"], whole.worn()["B"]["bearing"])
    volumes = [float(one.over_life("volume")[-1]) for one in (life, single)]
    told = [float(one.errors_of_volume[-1]) for one in (life, single)]
    assert abs(volumes[0] / volumes[1] - 1) < 1.5 * math.hypot(*told)
    assert any(stage.settled.lanes == rates.LANES for stage in life.stages)
