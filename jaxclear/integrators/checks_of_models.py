"""Figures of what a run's model leaves out, as `checks.Check` holds them: code, label, limit, what
the limit concerns, whose they are, sentence."""

from jaxclear.integrators import check_words as words

WEAR_BY_CELLS = (
    31,
    "cells: worn depth",
    0.1,
    "worn depth",
    words.SURFACES,
    'where joint "{place}" is worn deepest its scar is hardly wider than a cell of its map: over '
    "three cells it is {figure:.2g} of itself less deep (limit {limit:g}), so its depth hangs on "
    "their number and is too small, though volumes are right: give its Wearing more cells",
)
COULOMB_FRICTION = (
    25,
    "friction as Coulomb's",
    0.025,
    "wear",
    words.RUBBING,
    'friction in joint "{place}" is taken as Coulomb\'s; by its own law {figure:.2g} of its '
    "loss is another (limit {limit:g}), and wear with it: take integrator.ImplicitStep, or "
    "friction.Coulomb if that is meant",
)
COLLAR_FORCE = (
    26,
    "force on collars",
    0.05,
    "forces",
    words.COLLARS,
    'collars of joint "{place}" carry {figure:.2g} of its forces (limit {limit:g}), which is '
    "no contact force here, and rubs and wears nothing: take integrator.ImplicitStep",
)
UNHELD_FORCE = (
    29,
    "force along an unheld axis",
    0.05,
    "motion",
    words.UNHELD,
    'along the axis of joint "{place}" acts {figure:.2g} of its forces (limit {limit:g}), and '
    "nothing holds its journal there but this model: give it a flange, or let it slide on "
    "integrator.ImplicitStep",
)
JOURNAL_REACH = (
    30,
    "journal beyond its bearing",
    0.05,
    "motion",
    words.SLIDING,
    'the journal of joint "{place}" slides along its axis, out of {figure:.2g} of its bearing\'s '
    "length (limit {limit:g}; it is taken to reach three lengths where its own is not given), and "
    "contacts are told as if it still reached through: give it a flange, or its journal_length",
)
INDETERMINATE_FORCE = (
    27,
    "statically indeterminate force",
    0.05,
    "forces",
    words.TOUCHING,
    'statics does not tell what joint "{place}" carries: forces of its loop that no motion changes '
    "(along parallel axes, say) are left out here; shared among all joints that always touch they "
    "change its forces by {figure:.2g} of the largest (limit {limit:g}), with them friction and "
    "wear: give a joint of the loop more freedom, or clearance on integrator.ImplicitStep",
)
GAP_MOTION = (
    28,
    "motion in the gap",
    0.1,
    "forces",
    words.TOUCHING,
    'the force in joint "{place}" turns so fast that to follow it in the gap would take '
    "{figure:.2g} of it (limit {limit:g}): here parts follow at once, of themselves they lag, so "
    "forces, friction and wear are off: take integrator.ImplicitStep",
)
