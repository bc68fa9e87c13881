"""A trajectory as an xarray Dataset: every history by name, with units and meaning as
attributes."""

from typing import Any

import jax
import numpy as np

from jaxclear.results.trajectory import Trajectory

XYZ = ["x", "y", "z"]


def to_dataset(run: Trajectory) -> Any:
    """Body motion, contacts, reactions, coordinates, wear maps and, if tracked, energies."""
    import xarray

    columns: dict[str, Any] = {}

    def put(name, dims, values, unit, meaning):
        columns[name] = (dims, np.asarray(values), {"units": unit, "long_name": meaning})

    for body in run.mechanism.bodies:
        history = run.body(body)
        put(f"{body}.com", ("time", "axis"), history.com, "m", f"centre of mass of {body}")
        put(
            f"{body}.quaternion",
            ("time", "component"),
            history.quaternion,
            "1",
            f"orientation of {body}, scalar first",
        )
        put(
            f"{body}.velocity",
            ("time", "axis"),
            history.velocity,
            "m/s",
            f"velocity of the centre of mass of {body}",
        )
        put(
            f"{body}.spin",
            ("time", "axis"),
            history.spin,
            "rad/s",
            f"angular velocity of {body}, ground axes",
        )
    for name in run.mechanism.topology.clearances:
        history = run.contact(name)
        place = f"{name}.contact"
        put(
            f"{name}.offset",
            ("time", "axis"),
            history.offset,
            "m",
            f"journal against bearing of {name}, bearing axes",
        )
        put(
            f"{name}.indentation",
            ("time", place),
            history.indentation,
            "m",
            "overlap, positive in contact",
        )
        put(
            f"{name}.normal_force",
            ("time", place),
            history.normal_force,
            "N",
            "normal contact force",
        )
        put(
            f"{name}.slip_speed",
            ("time", place),
            history.slip_speed,
            "m/s",
            "sliding speed at the contact",
        )
        put(f"{name}.traction", ("time", place), history.traction, "N", "friction force")
    for name in run.mechanism.connections:
        history = run.reaction(name)
        put(
            f"{name}.force",
            ("time", "axis"),
            history.force,
            "N",
            f"force on the child of {name}, ground axes",
        )
        put(
            f"{name}.torque",
            ("time", "axis"),
            history.torque,
            "N m",
            f"torque on the child of {name}, ground axes",
        )
    for joint, surfaces in run.worn.items():
        for surface, depth in surfaces.items():
            dims = (f"{joint}.{surface}.around", f"{joint}.{surface}.along")
            put(f"{joint}.{surface}.worn_depth", dims, depth, "m", "worn depth at the end")
            volume = run.worn_volume(joint, surface)
            put(f"{joint}.{surface}.worn_volume", ("time",), volume, "m^3", "volume lost")
    if run.balanced:
        energies = run.energy_balance()
        for name in energies.__dataclass_fields__:
            put(f"energy.{name}", ("time",), getattr(energies, name), "J", name.replace("_", " "))
    coordinates = {
        "time": ("time", np.asarray(run.time), {"units": "s"}),
        "axis": XYZ,
        "component": ["w", *XYZ],
    }
    attributes = {
        "result": run.result,
        "accepted_steps": int(run.accepted_steps),
        "jax": jax.__version__,
    }
    return xarray.Dataset(columns, coordinates, attributes)
