"""How far a run and the same run in shorter steps are apart, by the check that judges it."""

from typing import Any

import numpy as np

from jaxclear.integrators.checks import Check
from jaxclear.integrators.figures import Figure
from jaxclear.multibody.state import ENERGIES
from jaxclear.multibody.system import wear_maps
from jaxclear.results.histories import contact_impulse
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.bounciness import ELASTIC, restitution_of
from jaxclear.simulation.two_passes import LEAST, NO_WEAR
from jaxclear.simulation.ways import Whereabouts, whereabouts

# By check how far two runs are apart, by place, and the names of these.
Apart = dict[Check, tuple[np.ndarray, tuple[str, ...]]]

# What friction takes, beside the most of all energies of the balance that come in or go out, below
# which nobody reads it; and what is rounding in any mechanism [J].
LEAST_LOSS, NO_LOSS = 1e-3, 1e-15
# Change of what friction takes from which on it counts on rungs that promise losses within 10 %.
LOOSE_LOSS = 0.05
# How far in their gap parts are elsewhere, beside the clearance, from where on what two runs wear
# agrees by chance: implicit steps and steps a quarter as long wore off the same within 2 %, twice
# what is right, at other places. So do mean forces: a thrown journal's were 3 % off, and the same
# within 1 % on steps of several lengths.
PARTED = 0.5


def opens(run: Trajectory) -> bool:
    """Whether contacts may open and close."""
    return bool(run.mechanism.topology.clearances)


def deepest_apart(run: Trajectory, other: Trajectory, joint: str | None = None) -> float:
    """Change of the deepest indentations beside the deepest, of all joints or of one."""
    figures = [one.checks.figures[Check.INDENTATION] for one in (run, other)]
    own = [joint in (None, place) for place in figures[0].places]
    return share_of_largest(*(np.asarray(figure.worst)[own] for figure in figures))


def _peaks_apart(run: Trajectory, other: Trajectory, check: Check) -> dict[str, float]:
    """By joint the change of its largest indentation or force beside that, or beside `LEAST` of the
    largest of all."""
    figures = [one.checks.figures[check] for one in (run, other)]
    largest = [
        {name: max(_of_joint(figure, name)) for name in dict.fromkeys(figure.places)}
        for figure in figures
    ]
    least = LEAST * max(max(each.values()) for each in largest)
    pairs = {name: (one, largest[1][name]) for name, one in largest[0].items()}
    return {
        name: abs(one - two) / max(one, two, least) if least > 0 else 0.0
        for name, (one, two) in pairs.items()
    }


def _of_joint(figure: Figure, joint: str) -> list[float]:
    worst = np.asarray(figure.worst)
    return [float(x) for x, place in zip(worst, figure.places, strict=True) if place == joint]


def share_of_largest(one: np.ndarray, other: np.ndarray) -> float:
    """Largest difference beside the largest of both."""
    largest = np.maximum(np.abs(one), np.abs(other)).max()
    return float(np.abs(one - other).max() / largest) if largest > 0 else 0.0


def friction_loss(run: Trajectory) -> np.ndarray:
    """What friction has taken [J]."""
    return _energies(run)[-1, ENERGIES.index("friction_loss")]


def _energies(run: Trajectory) -> np.ndarray:
    """The energies of the balance [J] at the saving times."""
    return np.asarray(run.states)[:, run.history.layout().energy_start :]


def _friction_loss_apart(run: Trajectory, other: Trajectory) -> float:
    """Difference of what friction has taken, beside that; where it takes next to nothing, beside
    `LEAST_LOSS` of the most of all energies."""
    one, two = (float(friction_loss(each)) for each in (run, other))
    most = LEAST_LOSS * float(np.abs(_energies(other)).max())
    return abs(one - two) / max(abs(one), abs(two), most, NO_LOSS)


def impulses(run: Trajectory, joints: tuple[str, ...]) -> np.ndarray:
    """What the normal forces of each joint have given over the run [N s]."""
    return _impulses_so_far(run, joints)[:, -1]


def _impulses_so_far(run: Trajectory, joints: tuple[str, ...]) -> np.ndarray:
    """The same up to each saving time (joints, time)."""
    return np.array([np.asarray(contact_impulse(run.history, name)) for name in joints])


def _impulses_on_the_way(run: Trajectory, other: Trajectory, joints: tuple[str, ...]) -> np.ndarray:
    """Of each joint the largest difference of what its normal forces have given at an instant,
    beside what those of the joint that gives most have in the end."""
    one, two = (_impulses_so_far(each, joints) for each in (run, other))
    largest = max(one[:, -1].max(), two[:, -1].max())
    apart = np.abs(one - two).max(axis=1)
    return apart / largest if largest > 0 else np.zeros(len(joints))


def _elsewhere(run: Whereabouts, other: Whereabouts) -> float:
    """How far bodies are apart, beside the longest way of both."""
    apart = np.abs(np.asarray(run.gone) - np.asarray(other.gone)).max(initial=0.0)
    way = max(float(one.way) for one in (run, other))
    return float(apart / way) if way > 0 else 0.0


def apart_by_check(
    run: Trajectory, other: Trajectory, gaps: float | None, doubts: bool, left: float = 0.0
) -> Apart:
    """By check how far two runs are apart, by place, and the names of these; `gaps`: from which
    difference of the places of bodies on these count (None: they do not, nor do places in gaps);
    `doubts`: whether a figure brings the run in doubt; `left`: share of what is wrong that the
    other leaves."""
    found: Apart = {}
    sunk: Figure | None = run.checks.figures.get(Check.INDENTATION)
    inside: tuple[np.ndarray, tuple[str, ...]] = (np.zeros(0), ())
    if opens(run) or doubts:
        here, there = (whereabouts(each.history) for each in (run, other))
        elsewhere = _elsewhere(here, there)
        found[Check.HALVED_MOTION] = (np.array([elsewhere]), ("",))
        if gaps is not None and gaps < elsewhere <= Check.HALVED_MOTION.limit:
            found[Check.BODY_PLACES] = (np.array([elsewhere]), ("",))
    if opens(run):
        bearings = run.history.model().system.bearings.items()
        names = tuple(name for name, bearing in bearings for _ in bearing.radii)
        off = np.abs(np.asarray(here.places) - np.asarray(there.places)).max(axis=0)
        inside = (off.reshape(len(names), -1).max(axis=1), names)
    if opens(run) and sunk is not None and gaps is not None:
        found[Check.PLACE_IN_GAP] = inside
    if opens(run) and sunk is not None:
        peaks = {Check.DEEPEST: Check.INDENTATION, Check.PEAK_FORCE: Check.LARGEST_FORCE}
        for check, figure in peaks.items():
            if figure in run.checks.figures:
                changes = _peaks_apart(run, other, figure)
                found[check] = (np.array(list(changes.values())), tuple(changes))
    if opens(run):
        joints = tuple(run.mechanism.topology.clearances)
        one, two = (impulses(each, joints) for each in (run, other))
        largest = max(one.max(), two.max())
        shares = abs(one - two) / largest if largest > 0 else np.zeros(len(joints))
        found[Check.MEAN_FORCE] = (shares, joints)
        # Rigid steps promise no place, and agree in mean forces by chance where paths have parted:
        # 13 % off, they changed by 1.7 % where places changed by half the clearance.
        rigid = run.formulation.forces_are_means
        counts = Check.PLACE_IN_GAP in found or rigid or _elastic(run)
        if counts and np.max(inside[0]) > Check.PLACE_IN_GAP.limit:
            far = np.max(inside[0]) > PARTED
            along = _impulses_on_the_way(run, other, joints) if far else shares
            found[Check.PARTED_FORCE] = (along, joints)
    if run.worn:
        wears = _worn_apart(run, other)
        wears |= _worn_by_chance(run, other, wears, inside)
        found[Check.HALVED_WEAR] = (np.array(list(wears.values())), tuple(wears))
    worn = found.get(Check.HALVED_WEAR)
    return found | _losses_apart(run, other, worn, gaps is not None, left)


def _losses_apart(
    run: Trajectory, other: Trajectory, worn: tuple | None, promised: bool, left: float = 0.0
) -> Apart:
    """How far off is what friction takes or, where no other check tells, what is `worn`; of rungs
    whose losses are not `promised` as those of a study's default, how far apart, from `LOOSE_LOSS`
    on."""
    least, loss = Check.FRICTION_LOSS.limit, 0.0
    rubs = run.history.balanced and any(friction_loss(each) != 0 for each in (run, other))
    if rubs:
        loss = _friction_loss_apart(run, other)
    wear = float(np.max(worn[0])) if promised and worn is not None else 0.0
    if promised:
        loss, wear = loss / (1 - left), wear / (1 - left)
    untold = least < wear <= Check.HALVED_WEAR.limit
    loss = max(loss, wear) if untold else loss
    found: Apart = {}
    if rubs and not promised and _has_bristles(run):
        found[Check.BRISTLE_LOSS] = (np.array([loss]), ("",))
    known = promised or not least < loss <= LOOSE_LOSS
    if known and (rubs or untold):
        found[Check.FRICTION_LOSS] = (np.array([loss]), ("",))
    return found


def _has_bristles(run: Trajectory) -> bool:
    """Whether some contact's friction remembers, and the run follows it."""
    if run.formulation.forces_are_means:
        return False
    joints = (run.mechanism.connections[name].joint for name in run.mechanism.topology.clearances)
    laws = (own.friction for joint in joints for own in joint.contact_laws())
    return any(law is not None and law.bristles for law in laws)


def _elastic(run: Trajectory) -> bool:
    """Whether impacts take no energy: of parted paths no rung knows mean forces."""
    return restitution_of(run.mechanism, run.checks) >= ELASTIC


def _worn_apart(run: Trajectory, other: Trajectory) -> dict[str, float]:
    """By joint the largest difference of what surfaces have lost and of their largest depths,
    beside these; of a surface that loses next to nothing beside `LEAST_LOSS` of what the one that
    loses most does, or what is no wear."""
    surfaces = [(joint, surface) for joint, maps in run.worn.items() for surface in maps]
    maps = wear_maps(run.history.model().system)
    areas = [float(np.sum(maps[joint][surface][0].areas())) for joint, surface in surfaces]
    lost, deep = (
        np.array([[float(of(each, *place)) for place in surfaces] for each in (run, other)])
        for of in (_lost, _deepest)
    )
    volumes = _beside(lost, NO_WEAR * np.power(areas, 1.5))
    depths = _beside(deep, NO_WEAR * np.sqrt(areas))
    shares = np.maximum(volumes, depths)
    return {
        joint: max(x for x, (name, _) in zip(shares, surfaces, strict=True) if name == joint)
        for joint in run.worn
    }


def _worn_by_chance(
    run: Trajectory, other: Trajectory, wears: dict[str, float], inside: tuple
) -> dict[str, float]:
    """By joint how far wear is apart on the way and in place, where parts are elsewhere in their
    gap so far that what is worn in the end agrees by chance; `inside`: how far they are, by the
    names of contacts."""
    far = {place for off, place in zip(*inside, strict=True) if off > PARTED}
    return {
        joint: max(apart, *(_on_the_way(run, other, joint, name) for name in run.worn[joint]))
        for joint, apart in wears.items()
        if joint in far
    }


def _on_the_way(run: Trajectory, other: Trajectory, joint: str, surface: str) -> float:
    """Largest difference of what a surface has lost at an instant, beside what it loses in all, and
    of the depth of a cell in the end, beside the deepest."""
    one, two = (np.asarray(each.worn_volume(joint, surface)) for each in (run, other))
    here, there = (np.asarray(each.worn[joint][surface]) for each in (run, other))
    return max(share_of_largest(one, two), share_of_largest(here, there))


def largest_loss(run: Trajectory) -> float:
    """What a surface loses in one saving interval, at most, beside all that it loses."""
    shares = [
        float(np.max(np.diff(volume), initial=0.0) / volume[-1]) if volume[-1] > 0 else 0.0
        for joint, surfaces in run.worn.items()
        for volume in (np.asarray(run.worn_volume(joint, surface)) for surface in surfaces)
    ]
    return max(shares, default=0.0)


def _lost(run: Trajectory, joint: str, surface: str) -> Any:
    return run.worn_volume(joint, surface)[-1]


def _deepest(run: Trajectory, joint: str, surface: str) -> Any:
    return np.max(run.worn[joint][surface])


def _beside(found: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Differences of numbers of two runs beside the larger one, or beside the least that counts."""
    larger = np.max(found, axis=0)
    least = np.maximum(least, LEAST_LOSS * np.max(larger, initial=0.0))
    return np.abs(found[0] - found[1]) / np.maximum(larger, least)
