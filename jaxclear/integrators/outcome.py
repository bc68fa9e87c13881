"""How a run can end, or fail to begin: one enumeration for integrators and studies."""

from jaxclear.ground.outcome import AbstractOutcome


class Outcome(AbstractOutcome):
    """How a run ended. `Outcome(code).sentence` says it; only `REACHED` (0) is a success.

    `UNASSEMBLED`, `OUT_OF_RANGE` and `OTHER_MODE` are those of samples of a study, whose numbers do
    not make a mechanism, or not the nominal one.
    """

    REACHED = 0, "The run reached its end."
    STEP_TOO_SMALL = (
        1,
        "The step size fell below the smallest allowed: the equations are too stiff or not finite "
        "here.",
    )
    TOO_MANY_STEPS = 2, "The allowed number of steps between two saved times was used up."
    NOT_FINITE = 3, "The state became infinite or not a number."
    ENERGY_GAINED = (
        4,
        "The mechanism gained energy that nothing gave it: the steps are too long for its contacts "
        "or loads. Take shorter ones.",
    )
    LAWS_NOT_MET = (
        5,
        "The laws of contact or friction were not met: the sweeps over the joints were used up far "
        "from their solution. Allow more of them (most_sweeps); joints that lock themselves "
        "may have no solution there.",
    )
    UNASSEMBLED = 6, "The mechanism cannot be assembled."
    OUT_OF_RANGE = (
        7,
        "A number of the mechanism lies outside its range (a negative clearance, say).",
    )
    LOOP_TORN = (
        8,
        "A loop came open by more than a run can mend: the steps are too long for this motion. "
        "Take shorter ones, or stabilisation=jaxclear.Projection().",
    )
    DEAD_POINT = (
        9,
        "A drive leads a closed loop beyond a dead point: from here no position closes the loop. "
        "Drive another joint, or keep the drive within reach.",
    )

    SUNK_IN = (
        10,
        "A journal, ball or slider sank into the wall that holds it by more than its own radius: "
        "for these loads and speeds the contact is too soft, or the steps are too long. Look at "
        "stiffness, loads and start, or take shorter steps.",
    )

    SINGULAR_POSITION = (
        11,
        "The mechanism is at a singular position, a linkage stretched flat, say: its loops leave "
        "more than one way to go on there, and their reactions are not determined. Change a "
        "length a little, keep the motion away from it, or take integrator.Adaptive() or shorter "
        "steps, which pass such places more often.",
    )

    OFF_THE_WALLS = (
        12,
        "A slider left the walls of its guide that wear: its corners went beyond "
        "guide_length about guide_middle. Give the SliderGuide longer walls, or another middle.",
    )

    OTHER_MODE = (
        13,
        "The mechanism was assembled in another mode than the nominal one: a position in which two "
        "of its ways to assemble meet lies between the two. Vary its numbers less, or give start= "
        "or guess= for more joints.",
    )

    @property
    def began(self) -> bool:
        """Whether there was a run at all."""
        return self not in (Outcome.UNASSEMBLED, Outcome.OUT_OF_RANGE, Outcome.OTHER_MODE)
