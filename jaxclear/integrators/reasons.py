"""Why each check of a run has the limit that it has: for the book, which shows them beside the
checks themselves."""

from jaxclear.integrators.checks import Check

__all__ = ["REASONS"]

REASONS: dict[Check, str] = {
    Check.LOOP_DRIFT: (
        "a loop that is open by so much moves like one with a clearance of a thousandth of "
        "its longest arm, which is what is studied here"
    ),
    Check.HALVED_MEAN_FORCES: (
        "what half the step changes is at least half of what is wrong, for steps of order 1 or "
        "more: mean forces are then right within a fifth"
    ),
    Check.HALVED_MOTION: (
        "three quarters of the promised accuracy of places, as a fourth of what is wrong remains "
        "in shorter steps of order 1; at that accuracy itself it told four of six runs of "
        "mechanisms drawn at random that were off by 2 to 40 % where no other check did"
    ),
    Check.PLACE_IN_GAP: (
        "what a quarter of the step changes is nearly all that is wrong: somewhat less than the "
        "promised accuracy of places in gaps, 5 % of the clearance, as it looks at fifty instants"
    ),
    Check.BODY_PLACES: (
        "the accuracy of places that Adaptive promises; of steps of a given length it is told from "
        "0.004 on, somewhat less than what steps of rk4 promise"
    ),
    Check.MEAN_FORCE: (
        "nearly all that is wrong, as of places in gaps: the accuracy of mean forces that steps "
        "of rk4 promise, half of that of implicit steps"
    ),
    Check.PARTED_FORCE: (
        "half the accuracy of mean forces that the default of studies promises, as two runs that "
        "have parted are both off; where paths have not parted, what differs falls with the step "
        "and shows in other figures"
    ),
    Check.DEEPEST: (
        "forces of contacts grow with about the power 1.5 of the indentation: peaks change by 15 "
        "%, somewhat less than the fifth that steps of rk4 promise; forces at an instant swing more"
    ),
    Check.PEAK_FORCE: (
        "half of the fifth that steps of rk4 promise of peaks: what a step counts amiss of a "
        "damper's first blow falls with the step alone"
    ),
    Check.LARGEST_FORCE: "none: it is told so that peaks between saving times are known",
    Check.FRICTION_LOSS: (
        "nearly all that is wrong: the accuracy of losses that steps promise which a study takes "
        "unasked; of methods of order 1 and implicit steps that damp, which promise less, it is "
        "told from 0.05 on"
    ),
    Check.BRISTLE_LOSS: (
        "a tenth of the accuracy of losses that implicit steps promise: of impacts within a step, "
        "in which bristles settle, it was 12 % off and changed by 1.1 %"
    ),
    Check.COULOMB_FRICTION: (
        "half of the accuracy of losses that NonColliding promises: of laws by slip it was the "
        "error that runs have beside compliant ones, of LuGre half of it"
    ),
    Check.COLLAR_FORCE: "the accuracy of mean forces that NonColliding promises",
    Check.UNHELD_FORCE: "as of collars; what is loaded there slides away",
    Check.JOURNAL_REACH: (
        "contact is told at the ends of the bearing: the lever between them is then off by a "
        "fortieth of the bearing's length, half the accuracy of forces"
    ),
    Check.INDETERMINATE_FORCE: (
        "the accuracy of mean forces that NonColliding promises: in spatial four-bars it was 0.44 "
        "and 0.62 where mean forces were 79 and 37 % off"
    ),
    Check.GAP_MOTION: (
        "twice the accuracy of mean forces that NonColliding promises: where it was 0.05 or less "
        "they were 2 % off at most, and 7 % where it was 3"
    ),
    Check.HALVED_CONTACT_FORCES: (
        "at least half of what is wrong, as of the mean forces that move joints; of contacts that "
        "press against each other it tells what moves nothing"
    ),
    Check.HALVED_FORCES: (
        "forces at an instant swing about their mean; a tenth is what reading them off a figure "
        "takes"
    ),
    Check.HALVED_WEAR: "worn volumes follow mean forces and sliding, and are as sure as these",
    Check.WEAR_BY_SAVES: (
        "told from what fewer saving times change, for errors that fall with their distance: of a "
        "journal that always touches it was 1.5 to 17 times the error beside many saving times; "
        "and from single losses over wide arcs, which in slider-cranks, four-bars and a 3RSR that "
        "rattle was 0.4 to 2.2 times the error of their cells; of these the deepest was nearer"
    ),
    Check.WEAR_BY_CELLS: (
        "of 192 depths of pins, tilted journals and balls on 12 to 144 cells around, those with a "
        "figure below it were off by 10 % at most, those above by up to 98 %"
    ),
    Check.CONTACT_STEP: (
        "a contact that is open before a step and nearly at its deepest after it is seen once on "
        "its way in: the peak lies somewhere between two steps"
    ),
    Check.IMPACT_STEP: (
        "what an impact is off by grows at every further one: of mechanisms drawn at random, two "
        "in five journals ended elsewhere in their gap by a tenth of it and more where steps of "
        "rk4 rose by 0.35 to 0.7, and one in ten below"
    ),
    Check.REBOUND_STEP: (
        "told from the share of an impact that falls within a step, and from how much the law and "
        "the step take; the laws' usual restitution of 0.9 is met whatever the step, within 5 %"
    ),
    Check.ENERGY_GAIN: (
        "a mechanism that nothing drives cannot gain energy; the accuracy of mean forces is allowed"
    ),
    Check.INDENTATION: ("contact laws are made for indentations that are small beside the radius"),
    Check.DAMPER_STEP: (
        "beyond 1 what a damper takes swings from step to step; contacts that share a body get "
        "there together before each does alone (in a slider-crank of two at 0.85); where it swings "
        "friction loss may be right within 1e-4, or off by 80 % (in the flap's joints)"
    ),
    Check.FRICTION_STEP: (
        "of journals that creep, of thrown ones and of mechanisms drawn at random every run whose "
        "friction loss or wear was off by more than 2 % was beyond it, and few others were"
    ),
    Check.CREEP_STEP: (
        "a journal that creeps is moved by what little the force falls short of holding it: from "
        "there on its loss is off by a few hundredths (where steps damp, by up to a tenth), as "
        "beside runs of Adaptive"
    ),
    Check.LOAD_STEP: (
        "mean forces and motion are off by what steps miss of an impulse, and places in gaps by "
        "what impacts make of it: a square wave of which steps missed 0.007 left a journal a third "
        "of its clearance elsewhere; told from the function alone, beside how far its impulse goes"
    ),
}
