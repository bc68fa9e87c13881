"""A run as an xarray Dataset: every history by name, with units and meaning as attributes."""

from typing import Any

import jax
import numpy as np

from jaxclear.ground.datasets import provenance
from jaxclear.multibody.own_numbers import turns
from jaxclear.results import histories
from jaxclear.results.state_history import StateHistory

XYZ = np.array(["x", "y", "z"], object)
# Fields of each history with dimension, unit and meaning; {} is the name of the body or joint.
BODY = {
    "com": ("axis", "m", "centre of mass of {}"),
    "quaternion": ("component", "1", "orientation of {}, scalar first"),
    "velocity": ("axis", "m/s", "velocity of the centre of mass of {}"),
    "spin": ("axis", "rad/s", "angular velocity of {}, ground axes"),
}
CONTACT = {
    "offset": ("axis", "m", "journal against bearing of {}, bearing axes"),
    "indentation": ("{}.contact", "m", "overlap, positive in contact"),
    "normal_force": ("{}.contact", "N", "normal contact force"),
    "slip_speed": ("{}.contact", "m/s", "sliding speed at the contact"),
    "traction": ("{}.contact", "N", "friction force"),
}
REACTION = {
    "force": ("axis", "N", "force on the child of {}, ground axes"),
    "torque": ("axis", "N m", "torque on the child of {}, ground axes"),
}


def to_dataset(history: StateHistory, worn: dict, attributes: dict) -> Any:
    """Body motion, contacts, reactions, coordinates, wear maps and, if tracked, energies."""
    import xarray

    columns: dict[str, Any] = {}

    def put(name, dims, values, unit, meaning):
        columns[name] = (dims, np.asarray(values), {"units": unit, "long_name": meaning})

    def put_all(names, read, fields):
        for name in names:
            found = read(history, name)
            for field, (dim, unit, meaning) in fields.items():
                dims = ("time", dim.format(name))
                put(f"{name}.{field}", dims, getattr(found, field), unit, meaning.format(name))

    mechanism = history.mechanism
    put_all(mechanism.bodies, histories.body, BODY)
    put_all(history.formulation.contact_joints(mechanism), histories.contact, CONTACT)
    for name in history.formulation.contact_joints(mechanism):
        impulse = histories.contact_impulse(history, name)
        put(f"{name}.contact_impulse", ("time",), impulse, "N s", "impulse of the normal forces")
    put_all(mechanism.connections, histories.reaction, REACTION)
    for name, coupling in mechanism.couplings.items():
        unit = "N m" if turns(mechanism, coupling) else "N"
        sent = histories.transmitted(history, name)
        put(f"{name}.transmitted", ("time",), sent, unit, "what the coupling transmits")
    for joint, surfaces in worn.items():
        for surface, depth in surfaces.items():
            dims = (f"{joint}.{surface}.around", f"{joint}.{surface}.along")
            put(f"{joint}.{surface}.worn_depth", dims, depth, "m", "worn depth at the end")
            volume = histories.worn_volume(history, joint, surface)
            put(f"{joint}.{surface}.worn_volume", ("time",), volume, "m^3", "volume lost")
    if history.balanced:
        energies = histories.energies(history)
        for name in energies.__dataclass_fields__:
            put(f"energy.{name}", ("time",), getattr(energies, name), "J", name.replace("_", " "))
    coordinates = {
        "time": ("time", np.asarray(history.time), {"units": "s"}),
        "axis": ("axis", XYZ),
        "component": ("component", np.array(["w", *XYZ], object)),
    }
    said = attributes | {"jax": jax.__version__, "mechanism": str(mechanism)}
    return xarray.Dataset(columns, coordinates, {"what": "run"} | said | provenance())
