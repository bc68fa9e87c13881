"""Which runs are in doubt, and get a second look.

Those whose steps have a given length and meet contacts, whatever their figures, where looking again
takes next to no time: what a figure tells of an impact is a guess at how far off it is, and how
that grows over further ones it cannot tell. Of longer ones those in which contacts rise or creep,
or bodies drift, by more than a little (less where impacts take little energy, or steps are of low
order), so that a long run which resolves its impacts costs no more than itself. And impacts that
take no energy, whatever the steps; rigid contact, whose impacts leave nothing in a step that tells
how long it is beside them; stops; and what swings many times without contacts, of which no figure
tells where an error controls the steps.
"""

import numpy as np

from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.integrators.checks import Check
from jaxclear.integrators.figures import Checks
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.bounciness import ELASTIC, restitution_of
from jaxclear.simulation.load_steps import changes, functions_of_time
from jaxclear.simulation.two_runs import friction_loss, opens

# Share of a study's samples in doubt from which on its nominal one is looked at.
MANY = 0.1
# Steps times coordinates up to which steps of a given length are looked at again whatever their
# figures: a second look takes four times as many, each about a microsecond, so a sixth of a second
# where compiling the run took two to six. Of a four-bar in 200 steps of "heun" it tells the 32 % of
# the clearance by which a journal is off, at a rise of indentations by 0.047.
BRIEF = 40_000
# Figures from which on a longer run is in doubt. By rk4 journals were 9 to 15 % of their clearance
# off at rises of 0.066 and 0.088, none of 21 runs by more than 0.1 % below 0.045; a journal whirled
# about by its friction had a mean force 65 % off at a damper step of 0.45 (benchmarks/attack.py).
DOUBTS = {
    Check.IMPACT_STEP: 0.02,
    Check.CONTACT_STEP: 0.02,
    Check.CREEP_STEP: 0.01,
    Check.HALVED_MOTION: 0.005,
    Check.DAMPER_STEP: 0.3,
}
# Restitution from which on what an impact is off by dies out so late that less rise of indentations
# brings a run in doubt, in proportion to what an impact takes: at 0.976 a pendulum was 6 % of its
# clearance off after 17 impacts, in steps in which indentations rose by 0.03.
BOUNCY = 0.9
OF_IMPACTS = (Check.IMPACT_STEP, Check.CONTACT_STEP)
# Share of these rises from which on steps of order 1 and 2 are in doubt, implicit ones too. By
# "heun" journals were 32 and 41 % of their clearance off at 0.047 and 0.044, in implicit steps 10 %
# at 0.022; at 0.085 a mean force was 11 % off by symplectic Euler, what friction took 39 %, a worn
# depth 78 %.
LOW_ORDER = 0.5
# Steps beyond those that end at saving times, some fifty an impact where an error controls them,
# from which on so many impacts may have followed each other that bouncy ones, and those of several
# bearings, which pass them on, bring a run in doubt of whose impacts no figure tells: of 20 of
# restitution 0.98 without friction each made errors grow by a half, and `Adaptive` was 60 % of the
# clearance off; of a double pendulum 5 % after forty; a slider-crank with two bearings of
# restitution 0.43 after some sixty (3187 steps) by 21 %, loosely by 1.6 clearances; one with a
# bearing of restitution 0.92 in a loose run of 449 steps by 15 %.
BOUNCES = 250
# And such steps without contacts: a bob that a stiff spring threw back some forty times was half of
# its way off by a loose `Adaptive` (462 steps), 2 % by the default (1730), another 4 % (94); a
# pendulum on a slide that is shaken fifteen times to and fro 12 % (114). Of steps of a given length
# windows, which tell of drift, told 1e-5 where such a bob was 10 % of its way off by `ImplicitStep`
# (2200 steps).
SWINGS = 50


def in_doubt(run: Trajectory, integrator: AbstractIntegrator) -> bool:
    """Whether a figure tells so. Rigid contact, which has none of these, always is, as is
    friction that stops slip within a step, however long, where its loss is asked for, and what
    keeps all that an impact is off by."""
    if run.formulation.forces_are_means:
        rubs = run.history.balanced and bool(friction_loss(run) != 0)
        return opens(run) or rubs or bool(doubted(run.checks))
    kept = restitution_of(run.mechanism, run.checks)
    if kept >= ELASTIC or bool(doubted(run.checks, kept, not integrator.follows_impacts)):
        return True
    untold = not set(OF_IMPACTS) & set(run.checks.figures)
    keeps = kept > BOUNCY or len(run.mechanism.topology.clearances) > 1
    return untold and keeps and _steps_beyond_saves(run) > BOUNCES


def _steps_beyond_saves(run: Trajectory) -> int:
    return int(run.accepted_steps) - len(run.time) + 1


def is_brief(run: Trajectory, integrator: AbstractIntegrator) -> bool:
    """Whether steps of a given length have met contacts, and are so few that a second look takes
    next to no time."""
    depths = run.checks.figures.get(Check.INDENTATION)
    if integrator.asked_step() is None or depths is None or not opens(run):
        return False
    return _are_few(run) and bool(np.max(np.asarray(depths.worst), initial=0.0) > 0)


def _are_few(run: Trajectory) -> bool:
    return int(run.accepted_steps) * run.mechanism.topology.coordinate_count <= BRIEF


def swings_on(run: Trajectory, integrator: AbstractIntegrator) -> bool:
    """Whether steps have gone to and fro without contacts: those of which no figure tells, where
    they are many, those of a given length where a second look takes next to no time; what is driven
    evenly and has no springs goes as it is led."""
    rig = run.mechanism
    asked = integrator.asked_step() is not None
    counts = _are_few(run) if asked else _steps_beyond_saves(run) > SWINGS
    if rig.topology.clearances or not counts:
        return False
    springs = any(load.springs_back() for load in rig.loads.values())
    shaken = any(changes(function) for function in functions_of_time(rig).values())
    return springs or shaken or not rig.driven


def meets_stops(run: Trajectory, integrator: AbstractIntegrator) -> bool:
    """Whether steps of a given length may meet a stop midway: of what they do there no figure
    tells, and windows lie elsewhere."""
    stops = any(load.sets_in() for load in run.mechanism.loads.values())
    return stops and integrator.asked_step() is not None


def doubted(checks: Checks, kept: float = 0.0, low_order: bool = False) -> np.ndarray:
    """Whether a figure brings each run in doubt, of contacts with the restitution that is `kept`,
    in steps of order 1 or 2 (`low_order`) or in better ones; samples stay in front.
    """
    known = checks.figures
    less = min(LOW_ORDER if low_order else 1.0, (1 - kept) / (1 - BOUNCY))
    beyond = [
        np.any(np.asarray(known[check].worst) > least * (less if check in OF_IMPACTS else 1), -1)
        for check, least in DOUBTS.items()
        if check in known
    ]
    return np.any(beyond, axis=0) if beyond else np.zeros((), bool)


def many_in_doubt(checks: Checks, opens: bool, kept: float = 0.0, low_order: bool = False) -> bool:
    """Whether runs of a study are, by their `checks` (samples in front); `opens`: whether contacts
    may open and close, with the restitution that is `kept`; `low_order`: as in `doubted`.
    Of rigid contact that is where it wears; friction of joints that always touch, which brings one
    run in doubt, does not here."""
    if opens and Check.INDENTATION not in checks.figures:
        return Check.HALVED_WEAR in checks.figures
    return bool(np.mean(doubted(checks, kept, low_order)) >= MANY)
