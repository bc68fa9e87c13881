"""A mechanism: bodies, connections and loads by name, read-only and checked before anything is
traced; and what `print` shows of it.

The numbers are leaves of a pytree; names, joint types and what is absent are its structure. Values
that are being traced are not checked: they were when the mechanism was built with numbers.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, NoReturn

import equinox as eqx
import jax
import numpy as np

from jaxclear.components.beam import (
    Beam,
    Piece,
    parts_of_beams,
    with_pieces,
    without_pieces,
)
from jaxclear.components.body import Body, Connection
from jaxclear.components.clearance import AbstractClearance
from jaxclear.components.coupling import AbstractCoupling
from jaxclear.components.joint import AbstractJoint
from jaxclear.components.joint.base import drive_of
from jaxclear.components.load import AbstractLoad
from jaxclear.ground.arguments import check_name, expect
from jaxclear.ground.ordered import Ordered
from jaxclear.ground.printing import (
    INDENT,
    fields_in_words,
    in_a_line,
    number_in_words,
    numbers_in_words,
)
from jaxclear.ground.quantity import (
    AbstractQuantified,
    as_number,
    on_device,
    with_fields,
    with_quantities,
)
from jaxclear.ground.recent_results import Key, Latest
from jaxclear.ground.table import as_table
from jaxclear.ground.wording import described, public_name
from jaxclear.multibody import validation
from jaxclear.multibody.joint_replacement import exchange_joint, start_arguments, without_loads_on
from jaxclear.multibody.loops import AsNeeded, Baumgarte, Projection
from jaxclear.multibody.magnitudes import check_plane, warn_of_magnitudes
from jaxclear.multibody.topology import (
    Redundancy,
    Topology,
    coordinate_units,
    grow_tree,
    is_sliding,
    moves_along,
    numbers_of_parts,
    unit_along,
)
from jaxclear.multibody.validation import check_couplings


class Parts(Ordered):
    """A dictionary of a built mechanism, in the order of its names, that cannot be changed in
    place. `|` and `copy` give a plain dictionary to build another mechanism from.

    Raises `TypeError` with a sentence where it is to be changed.
    """

    def _refuse_change(self, *_: Any, **__: Any) -> NoReturn:
        raise TypeError(
            "a built Mechanism is read-only: what is changed in it now would not be checked, and "
            "its motion would not follow. Build another: mechanism.with_joint(name, joint), "
            "mechanism.with_body(name, body), mechanism.with_load(name, load), "
            "mechanism.with_coupling(name, coupling) (None takes a load or a coupling out), or "
            "jaxclear.Mechanism(mechanism.bodies, mechanism.connections, mechanism.loads, "
            "couplings=mechanism.couplings, **mechanism.start_arguments | {'start': ...})."
        )

    __setitem__ = __delitem__ = __ior__ = _refuse_change
    update = setdefault = pop = popitem = clear = _refuse_change

    def __or__(self, other: Any) -> Any:
        return dict(self) | dict(other) if isinstance(other, Mapping) else NotImplemented

    def __ror__(self, other: Any) -> Any:
        return dict(other) | dict(self) if isinstance(other, Mapping) else NotImplemented

    def copy(self) -> dict[str, Any]:
        return dict(self)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (dict(self),)


class Bodies(Parts):
    """Bodies, of which pieces of beams are read from the numbers of their beam."""

    def __getitem__(self, name: str) -> Any:
        body = dict.__getitem__(self, name)
        return self[body.beam].piece(body.index) if isinstance(body, Piece) else body

    def get(self, name: str, default: Any = None) -> Any:
        return self[name] if name in self else default  # noqa: SIM401

    def values(self) -> Any:
        return [self[name] for name in self]

    def items(self) -> Any:
        return [(name, self[name]) for name in self]


AS_NEEDED = "as the integrator needs it: by Projection where its steps open them, else by Baumgarte"


def parts_as_drawn(mechanism: Any) -> dict[str, dict[str, Any]]:
    """Bodies, connections and loads by part, in which beams are whole."""
    parts = mechanism.bodies, mechanism.connections, mechanism.loads
    return dict(zip(PARTS, without_pieces(*parts, None), strict=False))


def in_words(mechanism: Any) -> str:
    """What it has in the first line; bodies, connections, loads, start and speeds, a line each."""
    parts = parts_as_drawn(mechanism) | {"couplings": mechanism.couplings}
    counts = [_count_in_words(part, names) for part, names in parts.items() if names]
    lines = [f"Mechanism: {', '.join(counts)}"]
    for part, entry in (
        ("bodies", lambda name, body: _numbers(body)),
        ("connections", lambda name, connection: _describe_connection(mechanism, name, connection)),
        ("loads", lambda name, load: _describe_load(mechanism, load)),
        ("couplings", lambda name, coupling: _describe_coupling(mechanism, coupling)),
        ("start", lambda name, values: _describe_coordinates(mechanism, name, values, "")),
        ("guess", lambda name, values: _describe_coordinates(mechanism, name, values, "")),
        ("speeds", lambda name, values: _describe_coordinates(mechanism, name, values, "/s")),
    ):
        if inputs := parts.get(part, getattr(mechanism, part)):
            width = max(map(len, inputs))
            lines += [part, *(f"  {n:<{width}}  {entry(n, x)}".rstrip() for n, x in inputs.items())]
    if mechanism.topology.loops and mechanism.stabilisation is not None:
        fixed = mechanism.stabilisation
        by = f"by {public_name(type(fixed))} {_numbers(fixed)}".rstrip()
        lines.append(f"loops held {AS_NEEDED if isinstance(fixed, AsNeeded) else by}")
    if mechanism.topology.overconstrained:
        lines.append(str(mechanism.topology.redundancy))
    return "\n".join(lines)


def _count_in_words(part: str, names: Any) -> str:
    """How many there are of a part, such as "2 loads"."""
    one = {"bodies": "body"}.get(part, part.removesuffix("s"))
    return f"{len(names)} {one if len(names) == 1 else part}"


def _describe_load(mechanism: Any, load: Any) -> str:
    return f"{public_name(type(load))} {_numbers(load, moves_along(mechanism, load))}"


def _describe_coupling(mechanism: Any, coupling: Any) -> str:
    return f"{public_name(type(coupling))} {_numbers(coupling, moves_along(mechanism, coupling))}"


def _describe_connection(mechanism: Any, name: str, connection: Connection) -> str:
    joint = connection.joint
    ends = f"{in_a_line(connection.parent)} to {in_a_line(connection.child)}"
    along = is_sliding(mechanism, name)
    parts = list(fields_in_words(joint, lambda metadata: unit_along(metadata, along)))
    part = [text for name, text in parts if not isinstance(getattr(joint, name), eqx.Module)]
    laws = [
        f"{INDENT}{text}" for name, text in parts if isinstance(getattr(joint, name), eqx.Module)
    ]
    first = f"{public_name(type(joint))}, {ends}; {', '.join(part)}".rstrip("; ")
    return "\n".join([first, *laws])


def _numbers(part: Any, along: bool = False) -> str:
    return numbers_in_words(part, lambda metadata: unit_along(metadata, along))


def _describe_coordinates(mechanism: Any, name: str, values: tuple, rate: str) -> str:
    units = coordinate_units(mechanism, name)
    if set(units) == {"1"} and len(values) in (1, 3):
        return f"{number_in_words(values)} rad{rate}"  # a rotation vector in place of a quaternion
    if len(units) != len(values) or "1" in units:
        return number_in_words(values)
    return ", ".join(f"{number_in_words(x)} {u}{rate}" for x, u in zip(values, units, strict=True))


def _guess(what: str, value: Any) -> tuple:
    several = isinstance(value, (tuple, list)) or getattr(value, "ndim", None)
    values = tuple(value) if several else (value,)
    try:
        result = tuple(as_number(x) for x in values)
    except ValueError:
        result = (None,)
    if not result or any(x is None or isinstance(x, eqx.Module) for x in result):
        raise ValueError(f"{what} is {described(value)}; it must be one number or several.")
    return result


def _as_dict(what: str, values: Any, needed: bool = False) -> dict[str, Any]:
    """A dictionary from names, each a text that says something; None is an empty one."""
    if values is None and not needed:
        return {}
    expect(values, Mapping, what, "a dictionary from names")
    for name in values:
        if not isinstance(name, str) or not name.strip():
            raise ValueError(
                f"a name in {what} is {described(name)}; it must be a text that is not empty."
            )
    return dict(values)


class Mechanism(AbstractQuantified):
    """Bodies that connections hold together, under loads.

    What is given in `start` and `speeds` is fixed; the rest is solved, nearest to the joints' homes
    and to rest, so that every loop closes and journals lie in the middle of their bearings as far
    as what is given lets them. More than the loops leave free is refused where it does not close
    them already (to 1e-6 of a radian or of the longest arm). In what is traced the first search
    counts: guess the whole tree there, as `jaxclear.assemblies(...).guess(i)` does.

    Parts are read-only: `with_joint`, `with_body`, `with_load` and `with_coupling` give another
    mechanism.

    Args:
        bodies: a `Body` by name, a dict.
        connections: a `Connection` by name, a dict.
        loads: loads by name, a dict of members of `jaxclear.load`; none by default.
        couplings: couplings by name, which tie motions (gears, screws), a dict of members of
            `jaxclear.coupling`; none by default.
        start: coordinates at the start by the name of a connection, or of a body (its place in the
            ground), a dict: 1 number [rad, m], all of the joint's coordinates, for a spherical
            joint 3 numbers (a rotation vector [rad]), for a body in space 3 (its origin [m]). It
            may name any joint: one that closes a loop, or one with clearance, whose turn and slide
            are those of the ideal joint that it would be.
        speeds: speeds at the start likewise, the joint's own [m/s, rad/s], a dict.
        guess: rough coordinates likewise [rad, m], a dict. Of the ways to assemble, and of what
            loops and `start` leave free, the nearest to all of them together is taken, in radians
            and shares of the longest arm (a warning says where a second is about as near;
            `jaxclear.assemblies` lists them).
        stabilisation: how closed loops are kept closed, `Projection` or `Baumgarte`, or None;
            "default": as the integrator of a run needs it, by `Projection` where its steps would
            open them, else by `Baumgarte`.

    Raises:
        ValueError: with a sentence that names what is wrong.
    """

    # `Parts`: read-only, and in the order of their names, by which the tree grows.
    bodies: dict[str, Body]
    connections: dict[str, Connection]
    loads: dict[str, AbstractLoad]
    couplings: dict[str, AbstractCoupling]
    start: dict[str, tuple]
    speeds: dict[str, tuple]
    guess: dict[str, tuple]
    stabilisation: Baumgarte | Projection | AsNeeded | None
    topology: Topology = eqx.field(static=True)
    # Names in `start`, `speeds` and `guess` as they were given: what is given first is held first.
    order: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        bodies: Mapping[str, Body],
        connections: Mapping[str, Connection],
        loads: Mapping[str, AbstractLoad] | None = None,
        *,
        couplings: Mapping[str, AbstractCoupling] | None = None,
        start: Mapping[str, Any] | None = None,
        speeds: Mapping[str, Any] | None = None,
        guess: Mapping[str, Any] | None = None,
        stabilisation: Baumgarte | Projection | AsNeeded | str | None = "default",
    ):
        parts = (
            _as_dict("bodies", bodies, needed=True),
            _as_dict("connections", connections, needed=True),
            _as_dict("loads", loads),
            _as_dict("couplings", couplings),
        )
        self.start, self.speeds, self.guess = (
            Parts({n: _guess(f'{what} of "{n}"', x) for n, x in _as_dict(what, values).items()})
            for what, values in (("start", start), ("speeds", speeds), ("guess", guess))
        )
        self.order = tuple(dict.fromkeys([*self.start, *self.speeds, *self.guess]))
        bodies, connections, loads = with_pieces(*parts[:3])
        parts = (Bodies(bodies), connections, loads, parts[3])
        validation.check_parts(*parts)
        validation.check_finite("the mechanism", self.start_arguments)
        self.bodies, self.connections, self.loads, self.couplings = _copy_shared_parts(parts)
        hinges = parts_of_beams(self.loads)
        self.topology = grow_tree(self.bodies, self.connections, self.couplings, hinges)
        usual = isinstance(stabilisation, str) and stabilisation == "default"
        self.stabilisation = AsNeeded() if usual else stabilisation  # type: ignore[assignment]
        expect(
            self.stabilisation,
            (Baumgarte, Projection, AsNeeded, type(None)),
            "stabilisation",
            "a jaxclear.Baumgarte, a jaxclear.Projection, or None for none",
        )
        validation.check_tree(self.topology, self.connections, self.loads)
        check_couplings(self.couplings, self.topology, self.bodies, self.connections)
        check_plane(self.topology, self.bodies, self.connections, self.loads)
        places = {"start": self.start, "guess": self.guess}
        validation.check_start(self.topology, self.bodies, self.connections, places, self.speeds)
        warn_of_magnitudes(self)

    @property
    def start_arguments(self) -> dict[str, dict[str, tuple]]:
        """What is given for the start, under its argument's name, in the order given."""
        parts = {"start": self.start, "speeds": self.speeds, "guess": self.guess}
        return {
            part: {name: entry[name] for name in self.order if name in entry}
            for part, entry in parts.items()
        }

    def _summary(self):
        return in_words(self)

    @property
    def driven(self) -> tuple[str, ...]:
        """Joints whose coordinate a drive prescribes."""
        return tuple(n for n, c in self.connections.items() if drive_of(c.joint) is not None)

    @property
    def baumgarte(self) -> Baumgarte | None:
        """What pulls drifting loops back within the equations of motion."""
        stabilisation = self.stabilisation
        if isinstance(stabilisation, AsNeeded):
            return None if stabilisation.projects else stabilisation.baumgarte
        return stabilisation if isinstance(stabilisation, Baumgarte) else None

    @property
    def projects(self) -> bool:
        """Whether loops are closed anew after every step."""
        fixed = self.stabilisation
        problem = isinstance(fixed, Projection) or (isinstance(fixed, AsNeeded) and fixed.projects)
        return problem and bool(self.topology.loops)

    def with_joint(self, name: str, joint: AbstractJoint | AbstractClearance) -> "Mechanism":
        """The mechanism with another joint in place of one, such as one with clearance in place of
        an ideal one.

        Name and markers, start, drive and loads on its coordinate stay. Of a joint that had no
        drive and gets one, start and loads on the coordinate are left out: the drive decides where
        it stands.

        Args:
            name: name of the connection.
            joint: the new joint, which constrains no more than the old one does, or no less.

        Returns:
            the other `Mechanism`.

        Raises:
            ValueError: for a name that does not exist, or a joint that does not fit.
        """
        connections = exchange_joint(self.connections, self.bodies, name, joint)
        start = dict(self.start_arguments)
        start["guess"], start["speeds"] = start_arguments(
            self.topology, connections, self.bodies, name, start, parts_of_beams(self.loads)
        )
        loads = self.loads
        if drive_of(self.connections[name].joint) is None and drive_of(connections[name].joint):
            loads = without_loads_on(loads, (name,))
            start = {
                what: {n: x for n, x in part.items() if n != name} for what, part in start.items()
            }
        return rebuilt(self, connections=connections, loads=loads, **start)

    def with_body(self, name: str, body: Body) -> "Mechanism":
        """The mechanism with another body in place of one, such as one of another mass.

        Args:
            name: name of the body.
            body: the new body.

        Returns:
            the other `Mechanism`.

        Raises:
            ValueError: for a name that does not exist; a new body needs a connection too, so give
                both to `Mechanism`.
        """
        check_name("body", name, self.bodies, " in this mechanism")
        expect(body, (Body, Beam), f'what is put in place of "{name}"', "a jaxclear.Body or Beam")
        return rebuilt(self, bodies=self.bodies | {name: body})

    def with_load(self, name: str, load: AbstractLoad | None) -> "Mechanism":
        """The mechanism with one load more, with another in place of the one of this name, or
        without it.

        Args:
            name: name of the load.
            load: the load; None: without it.

        Returns:
            the other `Mechanism`.

        Raises:
            ValueError: for None and a name that does not exist.
        """
        if load is None:
            removable = [n for n in self.loads if n not in parts_of_beams(self.loads)]
            check_name("load", name, removable, " in this mechanism")
            return self.with_loads({n: x for n, x in self.loads.items() if n != name})
        return self.with_loads(self.loads | {name: load})

    def with_loads(self, loads: Mapping[str, AbstractLoad]) -> "Mechanism":
        """The mechanism under other loads; everything else stays.

        Args:
            loads: all loads by name, a dict.

        Returns:
            the other `Mechanism`.
        """
        return rebuilt(self, loads=loads)

    def with_coupling(self, name: str, coupling: AbstractCoupling | None) -> "Mechanism":
        """The mechanism with one coupling more, with another in place of the one of this name, or
        without it.

        Args:
            name: name of the coupling.
            coupling: the coupling; None: without it.

        Returns:
            the other `Mechanism`.

        Raises:
            ValueError: for None and a name that does not exist, or a coupling that does not fit.
        """
        couplings: dict[str, Any] = dict(self.couplings)
        if coupling is None:
            check_name("coupling", name, couplings, " in this mechanism")
            del couplings[name]
        else:
            couplings[name] = coupling
        return rebuilt(self, couplings=couplings)

    def parameters(self) -> Any:
        """All numbers of the mechanism with unit and meaning, as a pandas table."""
        return as_table(
            [
                {
                    "name": name,
                    "value": np.asarray(leaf).tolist(),
                    "unit": unit,
                    "meaning": metadata.get("meaning", ""),
                }
                for name, leaf, metadata, unit in numbers_of_parts(self)
            ]
        )


def _copy_shared_parts(parts: tuple[dict[str, Any], ...]) -> tuple[Parts, ...]:
    """Parts whose numbers are each their own: of one bearing given to two joints a study may vary
    one clearance and leave the other."""
    view: set[int] = set()

    def entry_of(leaf):
        if isinstance(leaf, jax.core.Tracer) or not isinstance(leaf, jax.Array):
            return leaf
        first = id(leaf) not in view
        view.add(id(leaf))
        return leaf if first else on_device(np.array(leaf))

    def unshared(part):
        new = [entry_of(leaf) for leaf in jax.tree.leaves(part)]
        is_saved = all(a is b for a, b in zip(new, jax.tree.leaves(part), strict=True))
        return part if is_saved else jax.tree.unflatten(jax.tree.structure(part), new)

    return tuple(
        (Bodies if isinstance(one, Bodies) else Parts)(
            (name, unshared(part)) for name, part in dict.items(one)
        )
        for one in parts
    )


# Forms of mechanisms that were looked at: a form decides all that is looked at.
_SOUND_FORMS: Latest[bool] = Latest(64)


def check_mechanism(mechanism: Any, what: str) -> None:
    """Raises `ValueError` where something is no mechanism, or one of which a part was exchanged
    after it was built (by `equinox.tree_at`, say) for what is no such part or has other coordinates
    than the tree counts. Numbers are not looked at.

    Args:
        mechanism: what a user hands over.
        what: begins the message: what it is handed over as.
    """
    expect(mechanism, Mechanism, what, "a jaxclear.Mechanism")
    leaves, structure = jax.tree.flatten(mechanism)
    form = Key(structure, [jax.typeof(x) if eqx.is_array(x) else x for x in leaves])
    if _SOUND_FORMS.get(form) is None:
        eqx.filter_eval_shape(_check_form, with_quantities(mechanism))
        _SOUND_FORMS.keep(form, True)


def _check_form(mechanism: Mechanism) -> None:
    bodies, connections, loads = mechanism.bodies, mechanism.connections, mechanism.loads
    tree = mechanism.topology
    validation.check_parts(bodies, connections, loads, mechanism.couplings)
    grown = grow_tree(bodies, connections, mechanism.couplings, parts_of_beams(loads))
    if dataclasses.replace(grown, redundancy=tree.redundancy) == tree:
        return

    def is_changed(name: str) -> bool:
        joint, branch = connections[name].joint, tree.branch_of(name)
        if isinstance(joint, AbstractClearance) or name in tree.clearances:
            return isinstance(joint, AbstractClearance) != (name in tree.clearances)
        driven = drive_of(joint) is not None
        count = 0 if driven else len(joint.home)
        return driven if branch is None else branch.coordinate_count != count

    names = [f'joint "{name}"' for name in connections if is_changed(name)]
    raise ValueError(
        f"{' and '.join(names) or 'a part'} of the mechanism was changed after it was built, so "
        "that other joints have coordinates than its equations of motion count: a drive was put "
        "in or left out, or a joint exchanged. Exchange it by mechanism.with_joint(name, joint), "
        "or build another jaxclear.Mechanism."
    )


# Arguments of a mechanism beside what is given for its start.
PARTS = ("bodies", "connections", "loads", "couplings", "stabilisation")


def rebuilt(mechanism: Mechanism, **changed: Any) -> Mechanism:
    """The mechanism built anew, by these of its arguments in the place of its own."""
    entry = {part: getattr(mechanism, part) for part in PARTS}
    return Mechanism(**entry | mechanism.start_arguments | changed)


def ungiven(mechanism: Mechanism) -> Mechanism:
    """The mechanism with nothing given for its start."""
    none = (Parts(), Parts(), Parts())
    return eqx.tree_at(lambda m: (m.start, m.speeds, m.guess), mechanism, none)


def with_redundancy(mechanism: Mechanism, redundancy: Redundancy | None) -> Mechanism:
    """The mechanism with what is known of redundant rows in its loops."""
    if mechanism.topology.redundancy == redundancy:
        return mechanism
    topology = dataclasses.replace(mechanism.topology, redundancy=redundancy)
    return with_fields(mechanism, topology=topology)


def stabilised_as_needed(mechanism: Mechanism, projects: bool) -> Mechanism:
    """The mechanism as an integrator runs it that closes loops anew after every step (`projects`)
    or not, where nobody has said how its loops are held."""
    stabilisation = mechanism.stabilisation
    if not isinstance(stabilisation, AsNeeded) or stabilisation.projects == projects:
        return mechanism
    return with_fields(mechanism, stabilisation=AsNeeded(stabilisation.baumgarte, projects))


def without_stabilisation(mechanism: Mechanism) -> Mechanism:
    """The mechanism as its start is searched: by one program, however an integrator holds loops."""
    if mechanism.stabilisation is None:
        return mechanism
    return with_fields(mechanism, stabilisation=None)


def loosened(mechanism: Mechanism, names: tuple[str, ...]) -> Mechanism:
    """The mechanism with the coordinates of these names guessed, not given."""
    if not names:
        return mechanism
    start = {name: values for name, values in mechanism.start.items() if name not in names}
    guess = mechanism.guess | {name: mechanism.start[name] for name in names}
    return eqx.tree_at(lambda m: (m.start, m.guess), mechanism, (Parts(start), Parts(guess)))
