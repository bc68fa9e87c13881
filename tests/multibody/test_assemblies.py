"""What is guessed decides between the ways to assemble, all of which are known in closed form."""

import warnings

import jax
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators import Outcome
from tests.rigs.assembly_modes import PLANAR, rssr, triad, wrapped
from tests.rigs.cells import slow

MET = 1e-6
STEP = jc.integrator.FixedStep(1e-3)
SHIFTS = np.linspace(-1e-3, 1e-3, 5)[:, None]


def others(linkage):
    """Bodies that no drive and no start hold."""
    driven = {joint.child for joint in linkage.joints.values() if joint.angle is not None}
    return [n for n in linkage.modes[0] if n not in driven and n not in linkage.start]


def guessed(linkage, mode, kind, some):
    """A guess of a mode: of all joints, of all bodies, or of some of either."""
    angles, places = linkage.angles(mode), {n: mode[n] for n in others(linkage)}
    if kind == "joints":
        return angles
    if kind == "bodies":
        return places
    whole = angles if kind == "some joints" else places
    names = sorted(whole)
    kept = some.permutation(len(names))[: max(1, len(names) // 2)]
    return {names[i]: whole[names[i]] for i in kept}


def missed(linkage, mode, guess):
    """How far a mode is from a guess, in radians and metres."""
    apart = []
    for name, told in guess.items():
        if name in linkage.joints:
            apart.append(wrapped(linkage.angle(mode, name) - told))
        else:
            own = np.subtract(mode[name], told)
            apart += [own[0], own[1], wrapped(own[2])]
    return float(np.linalg.norm(apart))


def assembled(linkage, guess):
    """(the mode that is taken, what is said)."""
    rig = linkage.rig(guess)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        q = np.asarray(jc.assemble(rig).coordinates)
    branches = [b for b in rig.topology.branches if b.coordinate_count]

    def off(mode):
        return max(
            abs(wrapped(q[b.coordinates][0] - linkage.angle(mode, b.name))) for b in branches
        )

    found = min(linkage.modes, key=off)
    assert off(found) < MET
    return found, [str(one.message) for one in said]


def exact_guesses(name, kinds, count):
    """Of exact guesses of random modes: (how many were missed in silence, how many doubted)."""
    rng, wrong, told = np.random.default_rng(11), 0, 0
    for k in range(count):
        linkage = PLANAR[name](rng)
        mode = linkage.modes[rng.integers(len(linkage.modes))]
        # The same names every time: their numbers change, and nothing is compiled anew.
        guess = guessed(linkage, mode, kinds[k % len(kinds)], np.random.default_rng(2))
        found, said = assembled(linkage, guess)
        wrong += missed(linkage, found, guess) > MET and not said
        told += bool(said)
    return wrong, told


def test_an_exact_guess_is_met():
    """Of joints, whether the tree carries them or not."""
    assert exact_guesses("Watt", ("joints",), 8) == (0, 0)


@pytest.mark.slow(sample=False)
def test_exact_guesses_are_met_or_it_is_said():
    """160 in all, of all links or of some; at most one in twenty is said to be doubtful."""
    kinds = ("joints", "bodies", "some joints", "some bodies")
    wrong, told = np.sum([exact_guesses(name, kinds, 32) for name in PLANAR], axis=0)
    assert wrong == 0 and told <= 0.05 * 32 * len(PLANAR)


SLOW = pytest.mark.slow


@pytest.mark.parametrize("name", ["four-bar", *slow("3-RRR, platform held")])
def test_a_rough_guess_leads_to_the_nearest_mode_or_to_words(name):
    """Nearest in the joints' angles; where the second is less than twice as far it is said, with
    both distances."""
    rng, doubtful = np.random.default_rng(4), 0
    for _ in range(8):
        linkage = PLANAR[name](rng)
        here, there = rng.permutation(len(linkage.modes))[:2]
        share, there = rng.uniform(0.1, 0.45), linkage.angles(linkage.modes[there])
        angles = linkage.angles(linkage.modes[here])
        guess = {n: x + share * wrapped(there[n] - x) for n, x in angles.items()}
        found, said = assembled(linkage, guess)
        first, second = sorted(missed(linkage, mode, guess) for mode in linkage.modes)[:2]
        assert missed(linkage, found, guess) == pytest.approx(first, abs=MET)
        assert bool(said) == (second < 2 * first)
        if said:
            assert f"missed by {first:.3g} where" in said[0]
            assert f"by {second:.3g} where" in said[0]
            doubtful += 1
    assert doubtful


SLOW_COUNTS = {"Watt": 4, "3-RRR, cranks held": 2, "3-RRR, platform held": 8, "triad": 6}


@pytest.mark.parametrize(
    ("name", "count"),
    [("four-bar", 2), *(pytest.param(*item, marks=SLOW) for item in SLOW_COUNTS.items())],
)
def test_all_modes_are_listed_and_each_can_be_written_down(name, count):
    planar = (lambda rng: triad(rng, 6)) if name == "triad" else PLANAR[name]
    linkage = planar(np.random.default_rng(3))
    listed = jc.assemblies(linkage.rig())
    assert len(listed) == count == len(linkage.modes)
    assert str(listed).startswith(f"{count} ways to assemble, found by 64 searches; there may be")
    where = {b.name: b.coordinates.start for b in listed.mechanism.topology.branches}
    for mode in linkage.modes:
        angles = {n: x for n, x in linkage.angles(mode).items() if n in listed.names}
        off = [
            max(abs(wrapped(row[where[n]] - x)) for n, x in angles.items())
            for row in listed.coordinates
        ]
        assert min(off) < MET
    for i in range(count):
        again = jc.assemble(linkage.rig(listed.guess(i)))
        np.testing.assert_allclose(again.coordinates, listed.coordinates[i], atol=1e-9)
    assert np.all(listed.sign != 0) and np.all(listed.smallest > 0) and np.all(listed.counts > 0)
    if name != "triad":  # half of the modes lie on either side of the positions in which two meet
        assert listed.sign.sum() == 0


def test_a_spatial_four_bar_has_two_modes_with_its_idle_freedom():
    linkage = rssr(np.random.default_rng(6))
    listed = jc.assemblies(linkage.rig(), 16)
    column = listed.coordinates[:, listed.names.index("D")]
    np.testing.assert_allclose(np.sort(column), np.sort(linkage.modes), atol=MET)
    assert np.all(listed.sign == 0)


@pytest.mark.parametrize("kind", [*slow("rocker"), "coupler"])
def test_an_exact_guess_in_space_is_met_and_leaves_the_idle_freedom_where_it_is_guessed(kind):
    rng = np.random.default_rng(8)
    for _ in range(4):
        linkage = rssr(rng)
        mode, spin = linkage.modes[rng.integers(2)], rng.uniform(-2.0, 2.0)
        place = linkage.coupler_at(mode, spin)
        rig = linkage.rig({"D": mode} if kind == "rocker" else {"coupler": place})
        start = jc.assemble(rig)
        branch = rig.topology.branch_of("D")
        if branch is None or not branch.coordinate_count:
            continue
        assert abs(wrapped(start.coordinates[branch.coordinates][0] - mode)) < MET
        assert all(np.all(np.abs(np.asarray(away)) < MET) for away in start.away.values())


def test_runs_and_positions_take_the_mode_that_is_guessed_or_say_that_it_lies_between_two():
    linkage = PLANAR["four-bar"](np.random.default_rng(3))
    for mode in linkage.modes:
        # One angle alone, of a joint of the tree; the other begins at its home.
        rig = linkage.rig({"A": linkage.angle(mode, "A")})
        run = jc.simulate(rig, 1e-3, save=2, integrator=STEP)
        held = {"O": np.array([linkage.joints["O"].angle])}
        for found in (run, jc.positions(rig, held)):
            turn = np.asarray(found.body("rocker").rotation)[0]
            assert abs(wrapped(np.arctan2(turn[1, 0], turn[0, 0]) - mode["rocker"][2])) < MET
        assert not run.warnings
    here, there = (linkage.angle(mode, "A") for mode in linkage.modes)
    rig = linkage.rig({"A": here + 0.45 * wrapped(there - here)})
    sentence = 'the guess of "A" lies between two ways to assemble'
    with pytest.warns(UserWarning, match=sentence) as said:
        run = jc.simulate(rig, 1e-3, save=2, integrator=STEP)
    assert said[0].filename == __file__
    assert run.warnings[0].startswith(sentence) and run.warnings[0] in str(run)


def test_what_cannot_be_closed_is_refused():
    linkage = PLANAR["four-bar"](np.random.default_rng(3))
    far = linkage.joints["D"]._replace(at=(2.0, 0.0))
    rig = linkage._replace(joints=linkage.joints | {"D": far}).rig()
    with pytest.raises(ValueError, match="cannot be closed"):
        jc.assemblies(rig)


# --- samples keep the mode of the nominal ---


def sampled(linkage, guess, where, **spread):
    """A problem in which a number of the linkage varies."""
    return jc.Problem(
        linkage.rig(guess),
        {"A": jc.response.FinalCoordinate("A")},
        {"number": jc.Variable(where, **spread)},
        duration=1e-4,
        save=2,
        integrator=jc.integrator.FixedStep(1e-4),
    )


@pytest.mark.slow
def test_samples_keep_the_mode_to_which_a_search_has_led():
    """Of one of the two their own guess leads them to the other one."""
    linkage = PLANAR["four-bar"](np.random.default_rng(3))
    foot = lambda rig: rig.connections["D"].parent.at[0]
    for mode in linkage.modes:
        told = linkage.angle(mode, "A")
        problem = sampled(linkage, {"A": told}, foot, tolerance=1e-3)
        found = jax.jit(jax.vmap(problem.evaluate))(problem.nominal() + SHIFTS)
        assert np.all(np.asarray(found.outcome) == Outcome.REACHED)
        assert max(abs(wrapped(x - told)) for x in found.responses["A"].tolist()) < 0.1


def test_a_sample_in_another_mode_is_told():
    """Cranks all around: the elbow is on the nominal side, or the sample says that it is not."""
    linkage = PLANAR["four-bar"](np.random.default_rng(3))
    angle = lambda rig: rig.connections["O"].joint.drive.start
    mode = linkage.modes[0]
    problem = sampled(linkage, linkage.angles(mode), angle, tolerance=3.0)
    turns = np.linspace(-np.pi, np.pi, 48)[:, None]
    found = jax.jit(jax.vmap(problem.evaluate))(problem.nominal() + turns)
    outcomes, lengths = np.asarray(found.outcome), linkage.joints
    crank, coupler = lengths["A"].at[0], lengths["B"].at[0]
    turned = np.asarray(problem.nominal() + turns)[:, 0]
    ahead = turned + np.asarray(found.responses["A"])
    a = crank * np.stack([np.cos(turned), np.sin(turned)])
    rod = coupler * np.stack([np.cos(ahead), np.sin(ahead)])
    b = a + rod - np.array([[lengths["D"].at[0]], [0.0]])
    side = np.sign(rod[0] * b[1] - rod[1] * b[0])
    nominal = side[np.argmin(np.abs(turns))]
    assert np.all(side[outcomes == Outcome.REACHED] == nominal)
    assert np.all(side[outcomes == Outcome.OTHER_MODE] == -nominal)
    assert {*outcomes} <= {Outcome.REACHED, Outcome.OTHER_MODE, Outcome.UNASSEMBLED}


def test_a_four_bar_is_assembled_whose_nearest_place_is_stretched():
    """With all parts at their joints' places, the loop is nearest to closed where its links lie in
    one line, and there its rows depend; elsewhere they do not. Freudenstein's equation is met."""
    revolute, parts = jc.joint.Revolute, {"coupler": 0.2, "rocker": 0.12}
    rig = jc.Mechanism(
        {name: jc.Body(0.3, 1e-3) for name in ("crank", *parts)},
        {
            "A": jc.Connection(revolute(drive=jc.drive.ConstantSpeed(20.0)), "ground", "crank"),
            "B": jc.Connection(revolute(), "crank", "coupler", at=(0.06, 0)),
            "C": jc.Connection(
                revolute(), "coupler", jc.Marker("rocker", at=(0.12, 0)), at=(0.2, 0)
            ),
            "D": jc.Connection(revolute(), jc.Marker("ground", at=(0.18, 0)), "rocker"),
        },
    )
    found = jc.assemblies(rig)
    # Crank along the ground's line: the triangle of coupler, rocker and the 0.12 m that are left.
    angle = np.arccos((0.12**2 + 0.12**2 - 0.2**2) / (2 * 0.12 * 0.12))
    turns = np.sort([float(np.squeeze(found.guess(i)["D"])) for i in range(len(found))])
    np.testing.assert_allclose(turns, np.sort([np.pi - angle, angle - np.pi]), atol=1e-9)
    assert all(np.all(np.abs(np.asarray(x)) < 1e-9) for x in jc.assemble(rig).residuals.values())
