"""A run as an xarray DataTree: every history by body and joint, with units and meaning as
attributes."""

import functools
from typing import Any

import jax
import numpy as np

from jaxclear.components.joint.base import drive_of
from jaxclear.ground.datasets import provenance
from jaxclear.ground.warning import warn
from jaxclear.multibody.own_numbers import coordinate_units, turns
from jaxclear.results import histories
from jaxclear.results.state_history import StateHistory

XYZ = np.array(["x", "y", "z"], object)
# Fields of each history with dimension, unit and meaning; {} is the name of the body or joint.
BODY = {
    "com": ("axis", "m", "centre of mass of {}"),
    "quaternion": ("component", "1", "orientation of {}, scalar first"),
    "velocity": ("axis", "m/s", "velocity of the centre of mass of {}"),
    "spin": ("axis", "rad/s", "angular velocity of {}, ground axes"),
    "acceleration": ("axis", "m/s^2", "acceleration of the centre of mass of {}"),
    "angular_acceleration": ("axis", "rad/s^2", "angular acceleration of {}, ground axes"),
}
CONTACT = {
    "offset": ("axis", "m", "journal against bearing of {}, bearing axes"),
    "indentation": ("contact", "m", "overlap, positive in contact"),
    "normal_force": ("contact", "N", "normal contact force"),
    "slip_speed": ("contact", "m/s", "sliding speed at the contact"),
    "traction": ("contact", "N", "friction force"),
}
REACTION = {
    "force": ("axis", "N", "force on the child of {}, ground axes"),
    "torque": ("axis", "N m", "torque on the child of {}, ground axes"),
}


def of_run(history: StateHistory, worn: dict, attributes: dict, flat: bool) -> Any:
    """Body motion, contacts, reactions, wear maps and, if tracked, energies: as a tree by body,
    joint and surface, or as one flat data set."""
    import xarray

    nodes = _nodes(history, worn)
    coordinates = {
        "time": ("time", np.asarray(history.time), {"units": "s"}),
        "axis": ("axis", XYZ),
        "component": ("component", np.array(["w", *XYZ], object)),
    }
    said = attributes | {"jax": jax.__version__, "mechanism": str(history.mechanism)}
    said = {"what": "run"} | said | provenance()
    if not flat:
        root = {"/": xarray.Dataset(coords=coordinates, attrs=said)}
        below = {"/".join(path): xarray.Dataset(own) for path, own in nodes.items()}
        return _tree_class().from_dict(root | below)
    columns = {}
    for path, own in nodes.items():
        above = ".".join(path)
        for field, (dims, *rest) in own.items():
            every = tuple(dim if dim in coordinates else f"{above}.{dim}" for dim in dims)
            columns[f"{above}.{field}"] = (every, *rest)
    return xarray.Dataset(columns, coordinates, said)


def _nodes(history: StateHistory, worn: dict) -> dict[tuple[str, ...], dict[str, tuple]]:
    """By body, joint, coupling or surface its variables: dimensions, values, attributes."""
    nodes: dict[tuple[str, ...], dict[str, tuple]] = {}

    def put(path, field, dims, values, unit, meaning):
        told = {"units": unit, "long_name": meaning}
        nodes.setdefault(path, {})[field] = (dims, np.asarray(values), told)

    def put_all(names, read, fields):
        for name in names:
            found = read(history, name)
            for field, (dim, unit, meaning) in fields.items():
                values = getattr(found, field)
                put((name,), field, ("time", dim), values, unit, meaning.format(name))

    mechanism = history.mechanism
    put_all(mechanism.bodies, histories.body, BODY)
    put_all(history.formulation.contact_joints(mechanism), histories.contact, CONTACT)
    for name in history.formulation.contact_joints(mechanism):
        impulse = histories.contact_impulse(history, name)
        put((name,), "contact_impulse", ("time",), impulse, "N s", "impulse of the normal forces")
    put_all(mechanism.connections, histories.reaction, REACTION)
    for name, unit in _single_coordinates(history).items():
        what = "slides" if unit == "m" else "turns"
        place, speed = (history.coordinate(name, speeds=own) for own in (False, True))
        put((name,), "coordinate", ("time",), place, unit, f"how far {name} {what}")
        put((name,), "speed", ("time",), speed, f"{unit}/s", f"how fast {name} {what}")
    for name, coupling in mechanism.couplings.items():
        unit = "N m" if turns(mechanism, coupling) else "N"
        sent = histories.transmitted(history, name)
        put((name,), "transmitted", ("time",), sent, unit, "what the coupling transmits")
    for joint, surfaces in worn.items():
        for surface, depth in surfaces.items():
            where = joint, surface
            put(where, "worn_depth", ("around", "along"), depth, "m", "worn depth at the end")
            volume = histories.worn_volume(history, joint, surface)
            put(where, "worn_volume", ("time",), volume, "m^3", "volume lost")
    if history.balanced:
        energies = histories.energies(history)
        for name in energies.__dataclass_fields__:
            values = getattr(energies, name)
            put(("energy",), name, ("time",), values, "J", name.replace("_", " "))
    return nodes


def _single_coordinates(history: StateHistory) -> dict[str, str]:
    """Joints with one coordinate, of the tree or driven, with its unit."""
    mechanism = history.mechanism
    known = {own.name for own in mechanism.topology.branches if own.speed_count}
    known |= {n for n, own in mechanism.connections.items() if drive_of(own.joint) is not None}
    units = {name: coordinate_units(mechanism, name) for name in mechanism.connections}
    return {name: own[0] for name, own in units.items() if len(own) == 1 and name in known}


@functools.cache
def _tree_class() -> Any:
    """The class of a run's tree; xarray is loaded where data are asked for."""
    import xarray

    class RunTree(xarray.DataTree):
        """An xarray DataTree by body, joint and surface, whose root for one version answers to
        "crank.com" as to "crank/com", with a warning."""

        __slots__ = ()

        def __getitem__(self, key: Any) -> Any:
            path = self._path_of(key)
            if path is None:
                return xarray.DataTree.__getitem__(self, key)
            warn(
                f'the data of a run are a tree: "{key}" is now "{path}", and its flat name goes '
                "with the next version. run.to_dataset(flat=True) has all flat names.",
                DeprecationWarning,
            )
            return xarray.DataTree.__getitem__(self, path)

        def __contains__(self, key: object) -> bool:
            return xarray.DataTree.__contains__(self, key) or self._path_of(key) is not None

        def __reduce__(self) -> tuple:
            return xarray.DataTree.from_dict, (self.to_dict(),)

        def _path_of(self, key: Any) -> str | None:
            """The path that a flat name stands for; None for one that stands for none."""
            if not isinstance(key, str) or "." not in key:
                return None
            for path, node in self.subtree_with_keys:
                for field in node.data_vars:
                    if key == f"{path.replace('/', '.')}.{field}":
                        return f"{path}/{field}"
            return None

    return RunTree
