"""The attack on the engine's own judgement: that it draws every law, tells a wrong number from a
right one, and that a few of its cases are clean."""

from types import SimpleNamespace

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxclear as jc
from benchmarks import attack
from benchmarks.attacks import ideal, laws, tables, verdicts
from benchmarks.attacks.answers import RESPONSES
from benchmarks.attacks.attempts import Asked, Finding, attempt, nudged
from benchmarks.attacks.structures import structures
from benchmarks.attacks.verdicts import Verdict
from jaxclear.integrators.base import REFERENCE, RUNGE_KUTTA
from jaxclear.integrators.checks import Checks
from jaxclear.laws.friction import AbstractForceFriction


def test_every_law_with_a_force_is_drawn():
    contacts = {
        name for name in jc.contact.__all__ if name[0].isupper() and not name.startswith("Abstract")
    } - {"ContactForce", "Rigid", "Rough"}
    frictions = {
        name
        for name in jc.friction.__all__
        if not name.startswith("Abstract")
        and issubclass(getattr(jc.friction, name), AbstractForceFriction)
    }
    wears = {name for name in jc.wear.__all__ if not name.startswith("Abstract")}
    assert laws.members() == {"contact": contacts, "friction": frictions, "wear": wears}
    drawn = structures()
    assert {one.contact for one in drawn} - {""} == contacts
    assert {one.friction for one in drawn} - {""} == frictions
    assert {one.wear for one in drawn} - {""} == wears


def errors(**given):
    return dict.fromkeys(RESPONSES, np.nan) | {k.replace("_", " "): v for k, v in given.items()}


@pytest.mark.parametrize(
    ("error", "doubt", "spread", "warned", "verdict"),
    [
        (0.5, 0.0, 0.0, (), Verdict.RIGHT),
        (1.5, 0.0, 0.0, (), Verdict.WRONG),
        (np.nan, 0.0, 0.0, (), Verdict.WRONG),
        (np.inf, 0.0, 0.0, (), Verdict.WRONG),
        (1.5, 0.0, 0.0, ("mean force",), Verdict.SAID),
        (1.5, 0.0, 0.0, ("worn depth",), Verdict.WRONG),
        (0.5, 0.0, 0.0, ("mean force",), Verdict.RIGHT),
        (0.5, 0.4, 0.0, (), Verdict.RIGHT),
        (0.5, 0.6, 0.0, (), Verdict.UNSAID),
        (2.0, 1.0, 0.0, (), Verdict.UNSAID),
        (2.0, 1.0, 0.0, ("mean force",), Verdict.UNDECIDABLE),
        (9.0, 1.0, 0.0, (), Verdict.WRONG),
        (0.5, 0.0, 9.0, (), Verdict.RIGHT),
        (2.0, 0.0, 9.0, (), Verdict.UNSAID),
        (99.0, 0.0, 9.0, (), Verdict.WRONG),
    ],
)
def test_a_number_beyond_the_accuracy_counts_as_wrong_unless_a_warning_concerns_it(
    error, doubt, spread, warned, verdict
):
    """`error`, `doubt` (how far two references are apart) and `spread` (by how much the answer
    moves with the numbers' fifth digit) in units of the stated accuracy."""
    limit = REFERENCE.mean_force
    found = verdicts.judged(
        errors(mean_force=error * limit),
        errors(mean_force=doubt * limit),
        errors(mean_force=spread * limit),
        REFERENCE,
        frozenset(warned),
    )
    assert found == {"mean force": verdict}


def test_a_case_is_the_same_whenever_it_is_drawn():
    one, other = (structures()[4].case(7) for _ in range(2))
    assert one.duration == other.duration
    np.testing.assert_array_equal(
        one.mechanism.parameters()["value"], other.mechanism.parameters()["value"]
    )


@pytest.mark.parametrize(
    ("told", "failed", "warned"),
    [
        ({"mean force": 0.03, "worn depth": 0.03}, (), ()),
        ({"mean force": 0.06, "worn depth": 0.03}, (), ("mean force",)),
        ({"mean force": np.nan, "offset": 9.0}, (), ("mean force",)),
        ({}, ("losses",), ("friction loss", "worn volume", "worn depth")),
    ],
)
def test_a_run_warns_of_answers_whose_told_errors_are_beyond_its_promise(told, failed, warned):
    """`offset` is not promised; `failed`: parts beyond the promise of a run without figures."""
    promised = RUNGE_KUTTA._replace(gaps=None)
    run = SimpleNamespace(invariants=Checks(), verification=SimpleNamespace(beyond=failed))
    assert verdicts.concerned(run, told, promised) == frozenset(warned)


def row_of(told, true, apart=0.0, rung="default"):
    """A run whose place is off by so many times its promise, and what it tells of that."""
    found = Finding(
        Verdict.RIGHT, {}, {"place": true}, {}, (), told={"place": told}, limits={"place": 1.0}
    )
    return attack.Row(1, "pendulum", rung, "", found._replace(between={"place": apart}), 0.0)


def test_told_errors_stand_beside_true_ones_that_count():
    counted = [row_of(told, 0.5) for told in (0.1, 0.3, 2.0, 5.1)]
    small, unsure = row_of(9.0, 0.09), row_of(9.0, 0.3, apart=0.2)
    (default, *_, everything) = tables.told_beside_true([*counted, small, unsure])
    wanted = {"answers": 4, "told too small": 1, "told too large": 1, "told [%]": 50.0}
    assert default == {"of": "default"} | wanted and everything == {"of": "all"} | wanted


def test_a_run_without_contacts_tells_errors_of_its_reactions():
    slide = next(one for one in structures() if one.build is ideal.shaken_slide)
    coarse, fine = (
        attempt(slide.case(0), jc.integrator.FixedStep(step), Asked(saves=11)).told
        for step in (5e-4, 2.5e-4)
    )
    assert set(coarse) == {"place", "mean force", "peak force"}
    assert all(0 < fine[name] < 0.2 * coarse[name] for name in coarse)


def test_slightly_other_numbers_are_within_their_ranges():
    """Coarseness of cells is 1 at the least: a reference with less was refused."""
    rig = structures()[14].case(74).mechanism
    leaves = lambda of: jax.tree.leaves(eqx.filter(of, eqx.is_inexact_array))
    pairs = list(zip(leaves(rig), leaves(nudged(rig)), strict=True))
    assert any(np.any(leaf == 1) for leaf, _ in pairs)
    for leaf, other in pairs:
        np.testing.assert_array_equal(leaf != other, (leaf != 0) & (leaf != 1))


@pytest.mark.slow(sample=False)
def test_quick_attack_finds_no_wrong_number_of_the_default_without_a_sentence():
    rows = [
        row
        for structure in structures()[:: attack.QUICK_EVERY]
        for draw in range(attack.QUICK_DRAWS)
        for row in attack.attack(structure._replace(rungs=("default",)), draw)
    ]
    assert rows and not [row for row in rows if row.verdict in (Verdict.WRONG, Verdict.RAW)]
