"""A list of the ways in which a mechanism can be assembled: `assemblies`."""

import itertools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.printing import AbstractShown
from jaxclear.ground.quantity import is_traced
from jaxclear.ground.table import as_table
from jaxclear.ground.wording import listed
from jaxclear.multibody import assembly_modes, start_check
from jaxclear.multibody.assembly import FirstSearch, first_search
from jaxclear.multibody.assembly_modes import Mode
from jaxclear.multibody.mechanism import Mechanism, check_mechanism, rebuilt
from jaxclear.multibody.start_constraints import at_start
from jaxclear.multibody.topology import coordinate_units, joint_of


class Assemblies(AbstractShown):
    """The modes of a mechanism that searches have found, the nearest to what is guessed first.

    `coordinates` of the tree (`names` its columns), the `distance` from all that is guessed
    [radians and longest arms together; 0 where nothing is], the `sign` of the determinant of the
    rows that are held (0 where freedoms are left), their `smallest` singular value beside radians
    and longest arms (near 0: two modes meet close by), and by how many of `samples` searches each
    was found (`counts`).
    """

    mechanism: Mechanism
    coordinates: Float[np.ndarray, "modes q"]
    distance: Float[np.ndarray, " modes"]
    sign: Int[np.ndarray, " modes"]
    smallest: Float[np.ndarray, " modes"]
    counts: Int[np.ndarray, " modes"]
    samples: int = eqx.field(static=True)

    def __len__(self) -> int:
        return len(self.distance)

    @property
    def names(self) -> tuple[str, ...]:
        """What the columns of `coordinates` are: a joint or floating body, and which of its
        coordinates where it has several."""
        out = []
        for branch in self.mechanism.topology.branches:
            count = branch.coordinate_count
            out += [branch.name if count == 1 else f"{branch.name} {i}" for i in range(count)]
        return tuple(out)

    @property
    def _units(self) -> dict[str, str]:
        """Units of the columns of the table."""
        joints = [
            branch.name for branch in self.mechanism.topology.branches if branch.coordinate_count
        ]
        each = itertools.chain(*(coordinate_units(self.mechanism, name) for name in joints))
        part = {"distance": "rad, arms", "smallest singular value": "1"}
        return part | dict(zip(self.names, each, strict=True))

    def guess(self, index: int) -> dict[str, tuple[float, ...]]:
        """What to give as `Mechanism(guess=)` for a mode: all coordinates of the tree that `start`
        does not give, by joint or floating body [rad, m, parts of a quaternion]. Raises
        `ValueError` for an index that there is not."""
        check_count("index of an assembly", index, at_least=0)
        if index >= len(self):
            raise ValueError(f"assembly {index} was asked for; {len(self)} were found.")
        return as_guess(self.mechanism, self.coordinates[index])

    def table(self) -> Any:
        """A pandas table: distance, sign, smallest singular value, how often found, coordinates."""
        columns: dict[str, Any] = {
            "distance": self.distance,
            "sign": self.sign,
            "smallest singular value": self.smallest,
            "found": self.counts,
        }
        return as_table(
            columns | dict(zip(self.names, self.coordinates.T, strict=True)), units=self._units
        )

    def _summary(self):
        many = f"{len(self)} way{'s' * (len(self) != 1)} to assemble"
        text = f"{many}, found by {self.samples} searches; there may be more."
        if not len(self):
            return text
        if self.mechanism.guess:
            guessed = listed(self.mechanism.guess)
            text += f" Distance from the guess of {guessed} in radians and longest arms."
        return text, self.table()


@answering
def assemblies(mechanism: Mechanism, samples: int = assembly_modes.SEARCHES) -> Assemblies:
    """List the ways in which a mechanism can be assembled, as far as searches from random starts
    find them.

    What `start` gives is fixed. It is sampling: a mode to which few random starts lead may be
    missed; `counts` has how often each was reached. Where freedoms are left, a mode is all
    positions that can be reached from one another; the one nearest to the guess is listed, or
    nearest to the joints' homes where nothing is guessed. Takes seconds.

    Args:
        mechanism: the mechanism, with numbers.
        samples: number of searches, >= 1, each with journals in the middle of their bearings.

    Returns:
        `Assemblies`, a table to print; `.guess(i)` is what to give as `Mechanism(guess=)`.

    Raises:
        ValueError: if numbers are traced, or no way to assemble was found.
    """
    check_double_precision()
    check_mechanism(mechanism, "what is assembled")
    check_count("samples of assemblies", samples, at_least=1)
    if is_traced(mechanism):
        raise ValueError(
            "assemblies are listed of a mechanism with numbers; some are traced (by jax.jit, vmap "
            "or grad)."
        )
    first = first_search(mechanism, True)
    modes = _search_modes(mechanism, first, samples)
    if not modes and first.is_doubted:
        modes = first.without_redundancy().modes(samples)
    if not modes:
        start_check.refuse(first.mechanism, first.start)
    starts = [mode.start for mode in modes]
    return Assemblies(
        mechanism,
        np.array([np.asarray(start.coordinates) for start in starts]),
        np.array([mode.distance if mechanism.guess else 0.0 for mode in modes]),
        np.array([assembly_modes.sign_of_start(start) for start in starts]),
        np.array([assembly_modes.smallest_singular_value(start) for start in starts]),
        np.array([mode.searches for mode in modes]),
        int(samples),
    )


def as_guess(mechanism: Mechanism, coordinates: Any) -> dict[str, tuple[float, ...]]:
    """All coordinates of the tree that `start` does not give, by joint or floating body."""
    out, parts = {}, (mechanism.bodies, mechanism.connections)
    for branch in mechanism.topology.branches:
        part = tuple(map(float, coordinates[branch.coordinates]))
        if part and branch.name not in mechanism.start:
            still = (0.0,) * branch.speed_count
            part = at_start(branch, joint_of(branch, *parts), part, still)[0]
            out[branch.name] = tuple(map(float, part))
    return out


def _search_modes(mechanism: Mechanism, first: FirstSearch, samples: int) -> list[Mode]:
    """The modes that searches find. Where freedoms are left each search goes to what is guessed and
    to homes first, and from there to what is guessed; of two places that small steps lead from one
    to the other the nearer is listed."""
    if first.sought is None or not assembly_modes.leaves_free(first.start):
        return first.modes(samples)
    values = mechanism.start_arguments
    homes = as_guess(mechanism, _home_coordinates(mechanism))
    guessed = {n: x for n, x in values["guess"].items() if n in homes}
    total = rebuilt(mechanism, guess=homes | guessed)
    at_homes = first_search(total, first.concentric)
    result = at_homes.modes(samples)
    if values["guess"]:
        on = [(assembly_modes.at(mode.start.coordinates), mode.searches) for mode in result]
        result = assembly_modes.modes(first.tree, first.search, on)
    saved: list[Mode] = []
    for mode in result:
        for i, present in enumerate(saved):
            if _is_reached_from(mechanism, at_homes, present, mode):
                saved[i] = present._replace(searches=present.searches + mode.searches)
                break
        else:
            saved.append(mode)
    return saved


def _home_coordinates(mechanism: Mechanism) -> np.ndarray:
    parts = mechanism.bodies, mechanism.connections
    branches = [b for b in mechanism.topology.branches if b.coordinate_count]
    return np.array([x for branch in branches for x in joint_of(branch, *parts).home])


def _is_reached_from(mechanism: Mechanism, at_homes: FirstSearch, one: Mode, other: Mode) -> bool:
    """Whether a search that begins at one mode and is guessed at the other lands there."""
    begin = assembly_modes.at(one.start.coordinates)
    there = as_guess(mechanism, other.start.coordinates)
    guess = {name: tuple(jnp.asarray(x) for x in there[name]) for name in at_homes.mechanism.guess}
    start, sound = at_homes.search(begin, guess)
    places = [np.asarray(result.coordinates) for result in (start, other.start)]
    gap = np.max(np.abs(at_homes.tree.difference(*places)), initial=0.0)
    return bool(sound) and gap <= assembly_modes.SAME
