"""Figures of what a run's model leaves out, as `checks.Check` holds them: code, label, limit, what
the limit concerns, whose they are, sentence."""

from jaxclear.integrators import check_words as words

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
