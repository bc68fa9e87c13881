"""The ways in which a mechanism can be assembled, its modes: a search for closed loops leads to one
of them, and searches from many beginnings to most.

Modes are told apart by the coordinates of the tree, and judged by how far each is from all that is
guessed, in radians and longest arms together. A first search that ends so near to its guess that no
other mode can be nearer needs no more of them.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxclear.components.beam import parts_of_beams
from jaxclear.ground import factorisation
from jaxclear.ground.quantity import on_device
from jaxclear.ground.wording import listed
from jaxclear.multibody import start_check
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.start_equations import Start
from jaxclear.multibody.topology import joint_of

# Beginnings from which the nearest mode is sought, or all are: one to which one in sixteen leads is
# missed by one list in sixty.
SEARCHES = 64
# Two starts of which no coordinate differs by more are one [rad, longest arms].
SAME = 1e-4
# Beginnings lie within so many longest arms of the guess: as far as two links reach.
REACH = 2.0
# A mode less than so many times as far from what is guessed as the nearest is about as near.
ABOUT = 2.0


class Beginning(NamedTuple):
    """Coordinates at which a search begins, where `is_set`, elsewhere those of the mechanism's
    guess; `led`: whether it is led first to what is guessed of other joints than those of the
    tree."""

    is_set: Any
    led: Any
    coordinates: Any  # (q,)


class Mode(NamedTuple):
    """A way to assemble: its start, how far it is from all that is guessed [rad, longest arms], and
    how many searches led to it."""

    start: Start
    distance: float
    searches: int


class Nominal(eqx.Module):
    """The mode of a nominal mechanism, by which samples are judged: its coordinates, where a sample
    begins at them (None: at its own guess), its `rows` that are held, and the projection `across`
    them. `branches`: names of the tree."""

    coordinates: Float[Array, " q"] | None
    rows: Float[Array, "rows v"]
    across: Float[Array, "v v"]
    branches: tuple[str, ...] = eqx.field(static=True)

    def fits(self, mechanism: Mechanism) -> bool:
        """Whether another mechanism has the same tree: other formulations may see other joints."""
        return self.branches == tuple(branch.name for branch in mechanism.topology.branches)

    def keeps(self, mechanism: Mechanism, start: Start) -> Bool[Array, ""]:
        """Whether a start is of this mode, as far as the sign of a determinant tells it: of the
        rows that are held, times their transpose at the nominal, and of what they leave free there.
        It changes where two modes meet, and where a freedom has been followed so far that it no
        longer tells a place from its neighbours. True where it tells nothing; pure."""
        if not self.fits(mechanism) or start.rows.shape != self.rows.shape or not self.rows.size:
            return jnp.array(True)
        both = self.rows.T @ jax.lax.stop_gradient(start.rows) + self.across
        return factorisation.sign_of_determinant(both) > 0


def nominal(mechanism: Mechanism, start: Start, searched: bool) -> Nominal:
    """The mode of a start of a mechanism with numbers. Samples begin there where nothing is left
    free, or the mechanism's own guess has not led there (`searched`).

    Args:
        mechanism: the nominal one; only the names of its tree are read.
        start: its start; `start.rows` are the Jacobian of all equations that hold it.
        searched: whether other beginnings than the guess led to this start.
    """
    rows = np.asarray(start.rows)
    count = rows.shape[1]
    across = np.eye(count)
    if rows.size:
        _, sizes, directions = np.linalg.svd(rows)
        part = directions[: _rank_of(sizes)]
        across = across - part.T @ part
    total = np.trace(across) < 0.5
    coordinates = start.coordinates if searched or total else None
    branches = tuple(branch.name for branch in mechanism.topology.branches)
    return Nominal(coordinates, on_device(rows), on_device(across), branches)


# What a search makes of a beginning: a start, and whether it is sound.
Search = Callable[[Beginning], tuple[Start, Any]]


def at(coordinates: Any) -> Beginning:
    """A beginning at coordinates, led nowhere else."""
    return Beginning(np.asarray(True), np.asarray(False), jnp.asarray(coordinates))


def beginning_at_guess(mechanism: Mechanism) -> Beginning:
    """The mechanism's own beginning."""
    none = np.zeros(mechanism.topology.coordinate_count)
    return Beginning(np.asarray(False), np.asarray(True), none)


def has_landed(tree: "Coordinates", start: Start) -> bool:
    """Whether a start is so near to what is guessed that no other mode can be nearer, or about as
    near."""
    far = tree.distance(start)
    return far <= start_check.EXACT or _is_nearest(start, far)


def is_near_seed(tree: "Coordinates", start: Start) -> bool:
    """The same of all coordinates, those too of which nothing is guessed."""
    far = tree.difference(np.asarray(start.coordinates), tree.seed)
    return _is_nearest(start, float(np.linalg.norm(far)))


def _is_nearest(start: Start, far: float) -> bool:
    """Whether no other mode can be as near to a place that is so `far` from a start: another one
    is at least 2 s/L away, s the smallest singular value of the rows that are held and L a bound of
    their change with the coordinates (from 0 = J d + (L/2) d^2). The second derivative of a chain's
    end by two of its turns is as long as the first by one of them, so L is taken as the norm of J
    times the root of the number of turns."""
    rows = np.asarray(start.rows)
    if not rows.size or not np.all(np.isfinite(rows)):
        return not rows.size
    sizes = np.linalg.svd(rows, compute_uv=False)
    smallest = sizes[_rank_of(sizes) - 1]
    bound = np.linalg.norm(rows) * np.sqrt(rows.shape[1])
    return bool(bound > 0 and far <= 2.0 * smallest / bound / (1.0 + ABOUT))


def _rank_of(sizes: np.ndarray) -> int:
    """Of a matrix with these singular values."""
    return max(int(np.sum(sizes > start_check.EXACT * sizes[0])), 1)


def smallest_singular_value(start: Start) -> float:
    """Of the rows that are held, each measured in radians and longest arms [1]: near 0 where two
    modes meet."""
    rows = np.asarray(start.rows)
    return float(np.linalg.svd(rows, compute_uv=False)[-1]) if rows.size else float("nan")


def sign_of_start(start: Start) -> int:
    """Of the determinant of the rows that are held; 0 where these are not as many as the speeds."""
    rows = np.asarray(start.rows)
    square = rows.size and rows.shape[0] == rows.shape[1]
    return int(np.sign(np.linalg.det(rows))) if square else 0


def leaves_free(start: Start) -> bool:
    """Whether what is held leaves freedoms."""
    rows = np.asarray(start.rows)
    rank = _rank_of(np.linalg.svd(rows, compute_uv=False)) if rows.size else 0
    return rank < rows.shape[1]


def modes(
    tree: "Coordinates", search: Search, beginnings: Iterable[tuple[Beginning, int]]
) -> list[Mode]:
    """The modes to which searches lead, nearest to the guess first, with counts of searches.

    Modes that are about as near are ordered by the distance from where the mechanism itself begins.

    Args:
        tree: measures distances between coordinates of the tree.
        search: function from a beginning to a start and whether it is sound.
        beginnings: where searches begin, each with the number of searches that it stands for.
    """
    result: list[Mode] = []
    for begin, count in beginnings:
        start, sound = search(begin)
        if sound:
            result = _add_mode(tree, result, start, count)

    def rank(mode):
        near = round(mode.distance / start_check.EXACT)
        far = tree.difference(np.asarray(mode.start.coordinates), tree.seed)
        return near, float(np.linalg.norm(far))

    return sorted(result, key=rank)


def _add_mode(tree: "Coordinates", result: list[Mode], start: Start, count: int) -> list[Mode]:
    """Modes with one to which so many searches have led."""
    part = Mode(tree.unwound(start), tree.distance(start), count)
    for i, mode in enumerate(result):
        if _is_one(tree, mode.start, part.start):
            return [*result[:i], mode._replace(searches=mode.searches + count), *result[i + 1 :]]
    return [*result, part]


def _is_one(tree: "Coordinates", a: Start, b: Start) -> bool:
    """Whether two starts are of one mode. Of one that leaves freedoms those are told that meet what
    is guessed alike."""
    far = tree.difference(np.asarray(a.coordinates), np.asarray(b.coordinates))
    if np.max(np.abs(far), initial=0.0) <= SAME:
        return True
    away = tree.away(a) - tree.away(b)
    return len(away) > 0 and leaves_free(a) and bool(np.max(np.abs(away)) <= SAME)


def ambiguity_warning(mechanism: Mechanism, tree: "Coordinates", result: list[Mode]) -> str:
    """A warning that two modes are about as near to the guess, with both distances; "" where not.

    Args:
        mechanism: whose `guess` is ambiguous; without a guess there is no warning.
        tree: names the coordinate in which the two modes differ most.
        result: modes, nearest first (`modes`).
    """
    if len(result) < 2 or not mechanism.guess:
        return ""
    first, second = result[:2]
    if second.distance >= max(ABOUT * first.distance, start_check.EXACT):
        return ""
    places = [np.asarray(mode.start.coordinates) for mode in (first, second)]
    name = tree.farthest(*places)
    here, there = (tree.in_words(place, name) for place in places)
    more = (
        f"Guess {name} nearer to what is meant"
        if name.strip('"') in mechanism.guess
        else f"If the other is meant, guess {name} too"
    )
    return (
        f"the guess of {listed(mechanism.guess)} lies between two ways to assemble: it is missed "
        f"by {first.distance:.3g} where {here}, which is taken, and by {second.distance:.3g} where "
        f"{there} (radians and longest arms together). {more}; jaxclear.assemblies lists what "
        "there is."
    )


class Coordinates:
    """The coordinates of the tree of a mechanism with numbers, by branch: where they begin
    (`seed`), and by how much one is as far as a radian (`arm` [m] for lengths)."""

    def __init__(self, mechanism: Mechanism, seed: Any, arm: Any):
        parts = mechanism.bodies, mechanism.connections
        self.branches = [b for b in mechanism.topology.branches if b.coordinate_count]
        self.joints = [joint_of(branch, *parts) for branch in self.branches]
        self.units = np.array([unit for joint in self.joints for unit in joint.units], dtype=str)
        self.arm, self.seed = float(arm), np.asarray(seed)
        # Which coordinates are guessed: of a body in space, of which 3 numbers are, its place only.
        self.guessed = np.zeros(len(self.units), bool)
        for branch, joint in zip(self.branches, self.joints, strict=True):
            values = mechanism.guess.get(branch.name)
            if values is not None:
                total = all(joint.start_mask(values))
                self.guessed[branch.coordinates] = [total or unit != "1" for unit in joint.units]

    def away(self, start: Start) -> np.ndarray:
        """From all that is guessed to a start [rad, longest arms]."""
        part = self.difference(np.asarray(start.coordinates), self.seed)[self.guessed]
        return np.concatenate([part, *(np.ravel(x) for x in start.away.values())])

    def distance(self, start: Start) -> float:
        """How far a start is from all that is guessed [rad, longest arms]."""
        return float(np.linalg.norm(self.away(start)))

    def unwound(self, start: Start) -> Start:
        """A start whose angles are less the whole turns by which they are further from the seed."""
        q = np.asarray(start.coordinates)
        turns = np.round((q - self.seed) / (2 * np.pi)) * (self.units == "rad")
        if np.any(turns):
            repeats = np.concatenate([np.zeros(0, bool), *map(_is_periodic, self.joints)])
            q = q - np.where(repeats, 2 * np.pi * turns, 0.0)
        return start._replace(coordinates=jnp.asarray(q))

    def turn_warning(self, mechanism: Mechanism, start: Start) -> str:
        """A sentence for what is guessed and met but for whole turns, which couplings count; ""
        where nothing is."""
        far = np.asarray(start.coordinates) - self.seed
        turns = np.round(far / (2 * np.pi)) * ((self.units == "rad") & self.guessed)
        for branch in self.branches if mechanism.couplings else ():
            most = max(turns[branch.coordinates], key=abs)
            entry = {n: c.joints() for n, c in mechanism.couplings.items()}
            tied = [name for name, joints in entry.items() if branch.name in joints]
            if most and tied:
                others = [one for one in entry[tied[0]] if one != branch.name]
                return (
                    f'the guess of "{branch.name}" is met but for {abs(most):g} whole turns, which '
                    f'coupling "{tied[0]}" counts: guess the turns of {listed(others)} too.'
                )
        return ""

    def farthest(self, q: np.ndarray, other: np.ndarray) -> str:
        """The joint or body, in quotes, whose coordinates tell two places apart most."""
        spread = np.abs(self.difference(q, other))
        sizes = [np.max(spread[branch.coordinates]) for branch in self.branches]
        return f'"{self.branches[int(np.argmax(sizes))].name}"'

    def in_words(self, q: np.ndarray, name: str) -> str:
        """The coordinates of a joint or body, its name in quotes."""
        entry = next(b.coordinates for b in self.branches if f'"{b.name}"' == name)
        numbers = ", ".join(f"{x:.4g}" for x in q[entry])
        return f"{name} is at {numbers if len(q[entry]) == 1 else f'({numbers})'}"

    def difference(self, q: np.ndarray, other: np.ndarray) -> np.ndarray:
        """How far coordinates are from others [rad, longest arms], turns by the shorter way."""
        parts = []
        for branch, joint in zip(self.branches, self.joints, strict=True):
            x, far = q[branch.coordinates], other[branch.coordinates]
            four = np.array([unit == "1" for unit in joint.units])
            # A quaternion and its opposite are one rotation, of twice their angle.
            side = np.where(four & (np.sum(x[four] * far[four]) < 0), -1.0, 1.0)
            parts.append(np.where(four, 2.0, 1.0) * (x - side * far))
        difference = np.concatenate([np.zeros(0), *parts])
        difference = np.where(self.units == "rad", np.angle(np.exp(1j * difference)), difference)
        return np.where(self.units == "m", difference / self.arm, difference)


def _is_periodic(joint: Any) -> np.ndarray:
    """For each coordinate of a joint whether it is an angle that a whole turn brings back."""
    # Anywhere but at home, where a screw might seem to stand still.
    place = [0.3 * (i + 1) for i in range(len(joint.home))]

    def pose(q):
        result = joint.motion(tuple(map(jnp.asarray, q)))
        return np.array([float(x) for row in (*result.rotation, result.translation) for x in row])

    out = []
    for i, unit in enumerate(joint.units):
        there = [x + 2 * np.pi * (i == j) for j, x in enumerate(place)]
        out.append(unit == "rad" and bool(np.allclose(pose(there), pose(place), atol=SAME)))
    return np.array(out, dtype=bool)


def beginnings(mechanism: Mechanism, tree: Coordinates, count: int) -> Iterator[Beginning]:
    """Random beginnings of searches around the mechanism's own, from a fixed seed.

    Coordinates that `start` gives are kept; every other beginning keeps a random half of the guess
    too.

    Args:
        mechanism: whose `start` and `guess` name what is kept.
        tree: the mechanism's own beginning, with units and branches of the coordinates.
        count: number of beginnings.
    """
    random = np.random.default_rng(0)
    for k in range(count):
        led = k % 2 == 0
        heeded = [name for name in mechanism.guess if random.random() < 0.5]
        saved = {*mechanism.start, *(heeded if led else ()), *parts_of_beams(mechanism.loads)}
        q = tree.seed.copy()
        for branch, joint in zip(tree.branches, tree.joints, strict=True):
            part = np.array(
                [_draw(random, unit, tree.arm) for unit in joint.units[: branch.coordinate_count]]
            )
            four = np.array([unit == "1" for unit in joint.units])
            if four.any():
                part[four] /= np.linalg.norm(part[four])
            if branch.name not in saved:
                q[branch.coordinates] = np.where(four, part, q[branch.coordinates] + part)
        yield Beginning(jnp.array(True), jnp.array(led), jnp.asarray(q))


def _draw(random: np.random.Generator, unit: str, arm: float) -> float:
    if unit == "1":
        return random.normal()
    return random.uniform(-1.0, 1.0) * (np.pi if unit == "rad" else REACH * arm)
