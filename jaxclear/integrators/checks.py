"""By which figures a run is judged: each beside the limit up to which numbers can be trusted, and
the sentence that is said beyond. A figure is a number for each place (a joint, or the mechanism):
the worst that was met. A run that lacks the thing has none and pays nothing. Beyond `Check.ends_at`
a run ends.
"""

import enum

import numpy as np

from jaxclear.integrators import check_words as words
from jaxclear.integrators import checks_of_models
from jaxclear.integrators.abstract_check import NEVER, AbstractCheck
from jaxclear.integrators.check_words import AGAIN, OR_OFTEN, OR_WORN, TIGHTER
from jaxclear.integrators.outcome import Outcome


@enum.unique
class Check(AbstractCheck):
    """The figures of all runs, each beside its limit."""

    # Residual of a loop's closure beside the longest arm of the mechanism, at the saving times.
    LOOP_DRIFT = (
        0,
        "loop drift",
        1e-3,
        "motion",
        words.LOOPS,
        'the loop closed by joint "{place}" is open by {figure:.2g} of the longest arm (limit '
        "{limit:g}), so the motion is off: take shorter steps or "
        "stabilisation=jaxclear.Projection()",
        (3e-2, Outcome.LOOP_TORN),
    )
    # What half the step changes, in the windows of `simulation.spot_checks`.
    HALVED_MEAN_FORCES = (
        3,
        "halved steps: mean force",
        0.1,
        "motion",
        words.SPEEDS,
        'with steps of half the length the mean forces that move "{place}" change by '
        "{figure:.2g} of themselves (limit {limit:g}), so forces, and maybe the motion, are off: "
        "take shorter steps",
    )
    HALVED_MOTION = (
        11,
        "halved steps: motion",
        0.015,
        "motion",
        words.WHOLE,
        "with steps of half the length or less bodies would be elsewhere by {figure:.2g} of their "
        "way (limit {limit:g}), so the motion is off: take shorter steps",
    )
    HALVED_CONTACT_FORCES = (
        18,
        "halved steps: mean contact force",
        0.1,
        "forces",
        words.JOINTS,
        'with steps of half the length the mean contact force in joint "{place}" changes by '
        "{figure:.2g} of itself (limit {limit:g}), so forces are off, though the motion may be "
        "right: take shorter steps",
    )
    HALVED_FORCES = (
        4,
        "halved steps: force",
        0.1,
        "swinging forces",
        words.SPEEDS,
        'with steps of half the length the forces at an instant that move "{place}" change '
        "by {figure:.2g} of themselves (limit {limit:g}), so forces at an instant and their peaks "
        "are off, and maybe friction loss and wear, though mean forces and the motion may be "
        "right: take shorter steps",
    )
    HALVED_WEAR = (
        5,
        "halved steps: wear",
        0.05,
        "wear",
        words.SURFACES,
        'with steps of half the length or less the wear of joint "{place}" changes by {figure:.2g} '
        "(limit {limit:g}), so worn volumes and depths are off: take shorter steps",
    )
    # What fewer of the saving times would change, at which surfaces are updated.
    WEAR_BY_SAVES = (
        14,
        "saving times: worn depth",
        0.02,
        "worn depth",
        words.SURFACES,
        'where joint "{place}" wears hangs on the saving times, at which surfaces are updated: '
        "depths of its cells may be off by {figure:.2g} of themselves (limit {limit:g}), and after "
        "many impacts places in its gap, though volumes are right: save more often",
    )
    PLACE_IN_GAP = (
        12,
        "second look: place in gap",
        0.03,
        "places in gaps",
        words.CONTACTS,
        f'{OR_WORN} the parts of joint "{{place}}" are elsewhere in their gap by {{figure:.2g}} of '
        "the clearance (limit {limit:g}), so places in it at an instant and wear are off, though "
        f"mean forces may be right: {OR_OFTEN}",
    )
    BODY_PLACES = (
        19,
        "second look: places of bodies",
        0.001,
        "places",
        words.WHOLE,
        f"{OR_WORN} bodies are elsewhere by {{figure:.2g}} of their way (limit {{limit:g}}), so "
        f"their places are off, though forces may be right: {OR_OFTEN}",
    )
    MEAN_FORCE = (
        13,
        "second look: mean force",
        0.05,
        "forces",
        words.CONTACTS,
        f'{AGAIN} the mean of the contact forces in joint "{{place}}" changes by {{figure:.2g}} '
        f"of the largest of all joints (limit {{limit:g}}), so forces are off: {TIGHTER}",
    )
    PARTED_FORCE = (
        17,
        "second look: mean force of parted paths",
        0.01,
        "forces",
        words.CONTACTS,
        f"{OR_WORN} parts are elsewhere in their gaps, and with that the mean of contact forces "
        'in joint "{place}" changes by {figure:.2g} of the largest of all joints (limit '
        f"{{limit:g}}): {OR_OFTEN}",
    )
    DEEPEST = (
        20,
        "second look: deepest indentation",
        0.07,
        "peak forces",
        words.CONTACTS,
        f'{AGAIN} the deepest indentation in joint "{{place}}" changes by {{figure:.2g}} of itself '
        f"(limit {{limit:g}}), so peak forces are off, though mean forces may be right: {TIGHTER}",
    )
    PEAK_FORCE = (
        23,
        "second look: largest contact force",
        0.1,
        "peak forces",
        words.CONTACTS,
        f'{AGAIN} the largest force of a contact in joint "{{place}}" changes by {{figure:.2g}} of '
        f"itself (limit {{limit:g}}), so peak forces are off: {TIGHTER}",
    )
    FRICTION_LOSS = (
        16,
        "second look: friction loss",
        0.02,
        "wear",
        words.WHOLE,
        f"{AGAIN} what friction takes or wears changes by {{figure:.2g}} of itself (limit "
        f"{{limit:g}}), so friction loss and wear are off: {TIGHTER}",
    )
    # The same of bristles in steps of low order: two that do not resolve how these settle agree.
    BRISTLE_LOSS = (
        24,
        "second look: friction loss of bristles",
        0.01,
        "wear",
        words.WHOLE,
        f"{AGAIN} what bristles take by friction changes by {{figure:.2g}} of itself (limit "
        "{limit:g}), and steps in which bristles settle agree with each other more than they are "
        f"right, so friction loss and wear are off: {TIGHTER}",
    )
    # Largest rise of a contact's indentation within a step beside the largest that was met: of
    # steps in which a contact does the work of its law whatever their length.
    CONTACT_STEP = (
        6,
        "contact step",
        0.85,
        "forces",
        words.CONTACTS,
        'within a step the indentation in joint "{place}" grows by {figure:.2g} of the largest '
        "that was met (limit {limit:g}), so peak forces are those of the steps, not of the "
        "contact, and friction loss and wear of impacts may be off, though motion may be right: "
        "take shorter steps",
    )
    # The same of explicit steps; after a few impacts a body is where they put it.
    IMPACT_STEP = (
        2,
        "impact step",
        0.35,
        "motion",
        words.CONTACTS,
        'within a step the indentation in joint "{place}" grows by {figure:.2g} of the largest '
        "that was met (limit {limit:g}), so bodies come back from impacts as the steps have it, "
        "not the contact, and motion, forces and wear are off: take shorter steps, contact_steps, "
        "or integrator.ImplicitStep",
    )
    # Restitution of impacts that fall within such a step, beside that of their law.
    REBOUND_STEP = (
        10,
        "rebound step",
        0.08,
        "motion",
        words.CONTACTS,
        'impacts in joint "{place}" fall within a step and end with the restitution of the steps '
        "(rebound), which is off by about {figure:.2g} of the contact law's (limit {limit:g}), so "
        "motion, forces and wear are off: take shorter steps or integrator.Adaptive",
    )
    # Of what nothing drives or pushes: energy above that of the start, beside all it had to change.
    ENERGY_GAIN = (
        8,
        "energy gained",
        0.05,
        "motion",
        words.WHOLE,
        "the mechanism gained {figure:.2g} of its energy (limit {limit:g}) though nothing gave it "
        "any, so the motion is off: take shorter steps",
        (0.9, Outcome.ENERGY_GAINED),
    )
    INDENTATION = (
        7,
        "indentation",
        0.05,
        "forces",
        words.CONTACTS,
        'the indentation in joint "{place}" reaches {figure:.2g} of its radius (limit {limit:g}), '
        "for which no contact law was made: look at stiffness, loads and start",
        (1.0, Outcome.SUNK_IN),
    )
    # Of contacts that damp, which press hardest before they are deepest; it has no limit.
    LARGEST_FORCE = (
        22,
        "largest contact force",
        np.inf,
        "peak forces",
        words.CONTACTS,
        'the normal force in joint "{place}" reaches {figure:.2g} N (limit {limit:g})',
        NEVER,
        "N",
    )
    FRICTION_STEP = (
        1,
        "friction step",
        0.0125,
        "motion",
        words.CONTACTS,
        '{figure:.2g} of what friction takes in joint "{place}" is taken where it stops slip '
        "within a step (limit {limit:g}), so sliding, friction loss and wear may be far off, and "
        "with them where bodies are: take shorter steps or integrator.ImplicitStep",
    )
    # Rate of a contact's damping, times the step, beside what is stable alone: contacts that share
    # a body are together faster than each of them.
    DAMPER_STEP = (
        15,
        "damper step",
        0.75,
        "swinging forces",
        words.CONTACTS,
        'the damping of the contact in joint "{place}" is as fast as {figure:.2g} of what these '
        "steps follow in a lone contact (limit {limit:g}), so its forces at an instant and their "
        "peaks may swing about what they should be, and friction loss and wear be off, though mean "
        "forces may be right: take shorter steps, contact_steps, or integrator.ImplicitStep",
    )
    # Angle by which a contact vibrates in a step, or share of slip that friction stops in it if
    # that is less: a mean by the power of friction. Steps that damp count as longer ones.
    CREEP_STEP = (
        9,
        "creep step",
        0.1,
        "wear",
        words.CONTACTS,
        'joint "{place}" creeps, held by friction, and its contact vibrates by {figure:.2g} rad '
        "in a step (limit {limit:g}; numerical damping counts as longer steps), so friction loss "
        "and wear may be off: take shorter steps and rebound=1.0",
    )
    LOAD_STEP = (
        21,
        "load step",
        0.005,
        "motion",
        words.LOADS,
        'steps pass over {figure:.2g} of the impulse of "{place}", a function of time that changes '
        "within less than a step (limit {limit:g}), so the motion is off: take shorter steps",
    )
    # What the model leaves out.
    WEAR_BY_CELLS = checks_of_models.WEAR_BY_CELLS
    COULOMB_FRICTION = checks_of_models.COULOMB_FRICTION
    COLLAR_FORCE = checks_of_models.COLLAR_FORCE
    UNHELD_FORCE = checks_of_models.UNHELD_FORCE
    JOURNAL_REACH = checks_of_models.JOURNAL_REACH
    INDETERMINATE_FORCE = checks_of_models.INDETERMINATE_FORCE
    GAP_MOTION = checks_of_models.GAP_MOTION
