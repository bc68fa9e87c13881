"""What a run finds out about itself that no finer run of the same model would tell: loops that are
open, energy that nothing gave, contacts beyond their law, and what the model leaves out. How far
its numbers are off is told by replicas (`jaxclear.errors`).

A figure is a number for each place (a joint, or the mechanism), the worst that was met, beside the
limit up to which numbers can be trusted. A run that lacks the thing has none and pays nothing.
Beyond `Check.ends_at` a run ends.
"""

import enum

import numpy as np

from jaxclear.integrators.outcome import Outcome

NEVER = (np.inf, Outcome.REACHED)
# What a figure is told for.
LOOPS, SPEEDS, CONTACTS, SURFACES, WHOLE = "loops", "speeds", "contacts", "surfaces", "mechanism"
JOINTS, LOADS, RUBBING, COLLARS = "joints", "loads and drives", "joints that rub", "collars"
TOUCHING = "joints that always touch"
UNHELD = "joints that always touch and that nothing holds along their axis"
SLIDING = "journals that nothing holds along their axis"


class AbstractCheck(enum.IntEnum):
    """A figure by which a run is judged: its `label` in tables, `unit`, `limit`, what the limit
    `concerns` (motion, places, forces, peak forces, wear, worn depth, places in gaps), whose it is
    (`of`), and the `sentence` said beyond the limit. Beyond `ends_at` the run ends, by `outcome`.
    """

    label: str
    unit: str
    limit: float
    concerns: str
    of: str
    sentence: str
    ends_at: float
    outcome: Outcome

    def __new__(cls, code, label, limit, concerns, of, sentence, ends=NEVER, unit="1"):
        member = int.__new__(cls, code)
        member._value_ = code
        member.label, member.unit, member.limit = label, unit, limit
        member.concerns, member.of, member.sentence = concerns, of, sentence
        member.ends_at, member.outcome = ends
        return member


def _gone(code: int, label: str, limit: float, concerns: str, of: str = CONTACTS) -> tuple:
    """A check of earlier versions, of which kept runs and folders tell: no run asks it any more."""
    place = "" if of == WHOLE else ' in "{place}"'
    sentence = f"{label}{place}: {{figure:.2g}} (limit {{limit:g}}), told by an earlier version"
    return code, label, limit, concerns, of, sentence


@enum.unique
class Check(AbstractCheck):
    """The figures of all runs, each beside its limit."""

    # Residual of a loop's closure beside its own shortest part, at the saving times.
    LOOP_DRIFT = (
        0,
        "loop drift",
        1e-3,
        "motion",
        LOOPS,
        'the loop closed by joint "{place}" is open by {figure:.2g} of its shortest part (limit '
        "{limit:g}): take shorter steps or stabilisation=jaxclear.Projection()",
        (3e-2, Outcome.LOOP_TORN),
    )
    # The same beside the smallest clearance: where journals are is off by as much.
    LOOP_DRIFT_IN_GAPS = (
        32,
        "loop drift beside clearances",
        0.03,
        "places in gaps",
        LOOPS,
        'the loop closed by joint "{place}" is open by {figure:.2g} of the smallest clearance '
        "(limit {limit:g}): take shorter steps or stabilisation=jaxclear.Projection()",
    )
    # Of what nothing drives or pushes: energy above that of the start, beside all it had to change.
    ENERGY_GAIN = (
        8,
        "energy gained",
        0.05,
        "motion",
        WHOLE,
        "the mechanism gained {figure:.2g} of its energy (limit {limit:g}) though nothing gave it "
        "any: take shorter steps",
        (0.9, Outcome.ENERGY_GAINED),
    )
    INDENTATION = (
        7,
        "indentation",
        0.05,
        "forces",
        CONTACTS,
        'the indentation in joint "{place}" reaches {figure:.2g} of its radius (limit {limit:g}), '
        "for which no contact law was made: look at stiffness, loads and start",
        (1.0, Outcome.SUNK_IN),
    )
    LOAD_STEP = (
        21,
        "load step",
        0.005,
        "motion",
        LOADS,
        'steps pass over {figure:.2g} of the impulse of "{place}" (limit {limit:g}), which changes '
        "within less than a step: take shorter steps",
    )
    WEAR_BY_CELLS = (
        31,
        "cells: worn depth",
        0.1,
        "worn depth",
        SURFACES,
        'the deepest scar of joint "{place}" is hardly wider than a cell, its depth underestimated '
        "({figure:.2g}, limit {limit:g}): give its Wearing more cells",
    )
    # What the model leaves out.
    COULOMB_FRICTION = (
        25,
        "friction as Coulomb's",
        0.025,
        "wear",
        RUBBING,
        'friction in joint "{place}" is taken as Coulomb\'s; by its own law {figure:.2g} of its '
        "loss is another (limit {limit:g}): take integrator.ImplicitStep",
    )
    COLLAR_FORCE = (
        26,
        "force on collars",
        0.05,
        "forces",
        COLLARS,
        'collars of joint "{place}" carry {figure:.2g} of its forces (limit {limit:g}), which here '
        "rub and wear nothing: take integrator.ImplicitStep",
    )
    UNHELD_FORCE = (
        29,
        "force along an unheld axis",
        0.05,
        "motion",
        UNHELD,
        'along the axis of joint "{place}", where nothing but this model holds its journal, acts '
        "{figure:.2g} of its forces (limit {limit:g}): give it a flange",
    )
    JOURNAL_REACH = (
        30,
        "journal beyond its bearing",
        0.05,
        "motion",
        SLIDING,
        'the journal of joint "{place}" slides out of {figure:.2g} of its bearing\'s length (limit '
        "{limit:g}): give it a flange, or its journal_length",
    )
    INDETERMINATE_FORCE = (
        27,
        "statically indeterminate force",
        0.05,
        "forces",
        TOUCHING,
        'statics leaves {figure:.2g} of the force in joint "{place}" open (limit {limit:g}): give '
        "a joint of its loop more freedom, or clearance on integrator.ImplicitStep",
    )
    GAP_MOTION = (
        28,
        "motion in the gap",
        0.1,
        "forces",
        TOUCHING,
        'to follow its force through the gap of joint "{place}" would take {figure:.2g} of it '
        "(limit {limit:g}): take integrator.ImplicitStep",
    )
    # Of versions up to 0.29.
    HALVED_MEAN_FORCES = _gone(3, "halved steps: mean force", 0.1, "motion", SPEEDS)
    HALVED_MOTION = _gone(11, "halved steps: motion", 0.015, "motion", WHOLE)
    HALVED_CONTACT_FORCES = _gone(18, "halved steps: mean contact force", 0.1, "forces", JOINTS)
    HALVED_FORCES = _gone(4, "halved steps: force", 0.1, "swinging forces", SPEEDS)
    HALVED_WEAR = _gone(5, "halved steps: wear", 0.05, "wear", SURFACES)
    WEAR_BY_SAVES = _gone(14, "saving times: worn depth", 0.02, "worn depth", SURFACES)
    PLACE_IN_GAP = _gone(12, "second look: place in gap", 0.03, "places in gaps")
    BODY_PLACES = _gone(19, "second look: places of bodies", 0.001, "places", WHOLE)
    MEAN_FORCE = _gone(13, "second look: mean force", 0.05, "forces")
    PARTED_FORCE = _gone(17, "second look: mean force of parted paths", 0.01, "forces")
    DEEPEST = _gone(20, "second look: deepest indentation", 0.07, "peak forces")
    PEAK_FORCE = _gone(23, "second look: largest contact force", 0.1, "peak forces")
    FRICTION_LOSS = _gone(16, "second look: friction loss", 0.02, "wear", WHOLE)
    BRISTLE_LOSS = _gone(24, "second look: friction loss of bristles", 0.01, "wear", WHOLE)
    CONTACT_STEP = _gone(6, "contact step", 0.85, "forces")
    IMPACT_STEP = _gone(2, "impact step", 0.35, "motion")
    REBOUND_STEP = _gone(10, "rebound step", 0.08, "motion")
    LARGEST_FORCE = _gone(22, "largest contact force", NEVER[0], "peak forces")
    FRICTION_STEP = _gone(1, "friction step", 0.0125, "motion")
    DAMPER_STEP = _gone(15, "damper step", 0.75, "swinging forces")
    CREEP_STEP = _gone(9, "creep step", 0.1, "wear")


# Those that runs are asked.
LIVE = (
    Check.LOOP_DRIFT,
    Check.LOOP_DRIFT_IN_GAPS,
    Check.ENERGY_GAIN,
    Check.INDENTATION,
    Check.LOAD_STEP,
    Check.WEAR_BY_CELLS,
    Check.COULOMB_FRICTION,
    Check.COLLAR_FORCE,
    Check.UNHELD_FORCE,
    Check.JOURNAL_REACH,
    Check.INDETERMINATE_FORCE,
    Check.GAP_MOTION,
)
