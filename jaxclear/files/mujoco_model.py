"""URDF and MJCF as MuJoCo reads them: its compiler settles defaults, units, frames and inertias.
Meshes that are not there are left out where bodies state their inertia themselves, and so is what
the file's flags disable.
"""

import importlib.util
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxclear.ground.arguments import check_flags, check_name
from jaxclear.ground.wording import described, listed

# Of mjtJoint; slides and hinges come after balls.
FREE, SPHERICAL, SLIDE = 0, 1, 2
# Where a URDF begins, and what has MuJoCo keep what is only seen of it.
ROBOT = re.compile(r"<robot\b[^>]*>")
KEEP = '<mujoco><compiler discardvisual="false"/></mujoco>'


class Compiled(NamedTuple):
    """A model of MuJoCo, its file's name, names of meshes left out, and what MuJoCo warned of."""

    model: Any
    name: str
    without: tuple[str, ...]
    warned: tuple[str, ...] = ()


def compiled(path: Any, *, floating: bool, visible: bool = False) -> Compiled:
    """The model in a file of URDF or MJCF, as MuJoCo compiles it.

    Args:
        path: of the file.
        floating: whether root bodies without a joint get a free one.
        visible: whether geometries that are only for display are read too.

    Raises:
        ValueError: MuJoCo cannot read the file.
        ImportError: MuJoCo is not installed.
    """
    check_flags("the import", floating=floating)
    if importlib.util.find_spec("mujoco") is None:
        raise ImportError(
            'URDF and MJCF are read by MuJoCo: python -m pip install "jaxclear[import]".'
        )
    if not isinstance(path, (str, Path)) or not str(path):
        raise ValueError(f"the file is {described(path)}; it must be a path.")
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"{path} is no file; give that of a model in URDF or MJCF.")
    import mujoco

    # It would write a log into the working directory.
    before, warned = mujoco.get_mju_user_warning(), dict[str, None]()
    mujoco.set_mju_user_warning(lambda message: warned.setdefault(" ".join(str(message).split())))
    try:
        spec = _spec_with_visuals(path) if visible else mujoco.MjSpec.from_file(str(path))
        # Welded bodies keep their names.
        spec.compiler.fusestatic = False
        if floating:
            _add_free_joints(spec)
        result = _compile_spec(spec, path.name)
        _remove_disabled(result.model)
        return result._replace(warned=tuple(warned))
    except (ValueError, mujoco.FatalError, UnicodeError, OSError) as error:
        message = " ".join(str(error).split()).rstrip(".")
        raise ValueError(f"MuJoCo cannot read {path.name}: {message}.") from None
    finally:
        mujoco.set_mju_user_warning(before)


def _spec_with_visuals(path: Path) -> Any:
    """The file's content with a URDF's visual geometries, which are dropped unless it says no."""
    import mujoco

    text = path.read_text(encoding="utf-8")
    begin = ROBOT.search(text)
    if begin is None or "<mujoco" in text:
        return mujoco.MjSpec.from_file(str(path))
    spec = mujoco.MjSpec.from_string(f"{text[: begin.end()]}{KEEP}{text[begin.end() :]}")
    spec.modelfiledir = str(path.resolve().parent)
    return spec


def _add_free_joints(spec: Any) -> None:
    for body in spec.worldbody.bodies:
        if not list(body.joints):
            body.add_freejoint()


def _compile_spec(spec: Any, name: str) -> Compiled:
    """The model, without its meshes where these are not to be had."""
    again = spec.copy()
    try:
        return Compiled(spec.compile(), name, ())
    except ValueError as first:
        meshed = [geom for geom in again.geoms if geom.meshname]
        if not meshed:
            raise
        without = tuple(dict.fromkeys(geom.meshname for geom in meshed))
        for geom in meshed:
            again.delete(geom)
        for mesh in list(again.meshes):
            again.delete(mesh)
        try:
            return Compiled(again.compile(), name, without)
        except ValueError as second:
            raise ValueError(f"{first}; and without meshes: {second}") from None


def is_disabled(model: Any, what: str) -> bool:
    """Whether the file's flags disable something, by its name in MuJoCo's `mjtDisableBit`."""
    import mujoco

    bit = getattr(mujoco.mjtDisableBit, f"mjDSBL_{what}")
    return bool(int(model.opt.disableflags) & int(bit))


def _remove_disabled(model: Any) -> None:
    """Takes out of a model what its flags disable, so that nobody reads it."""
    nothing: list[Any] = []
    constraints = is_disabled(model, "CONSTRAINT")
    if is_disabled(model, "GRAVITY"):
        nothing += [model.opt.gravity, model.body_gravcomp]
    if constraints or is_disabled(model, "LIMIT"):
        nothing += [model.jnt_limited]
    if constraints or is_disabled(model, "FRICTIONLOSS"):
        nothing += [model.dof_frictionloss]
    if constraints or is_disabled(model, "CONTACT"):
        nothing += [model.geom_contype, model.geom_conaffinity]
    if constraints or is_disabled(model, "EQUALITY"):
        nothing += [model.eq_active0]
    if is_disabled(model, "SPRING"):
        nothing += [model.jnt_stiffness, model.jnt_stiffnesspoly]
    if is_disabled(model, "DAMPER"):
        nothing += [model.dof_damping, model.dof_dampingpoly]
    for values in nothing:
        values[...] = 0


def names_of(model: Any) -> tuple[list[str], list[str]]:
    """Names of bodies (the world, called "ground", first) and of joints: each its own, so that a
    name says which of the two is meant."""
    bodies = ["ground"]
    for index in range(1, model.nbody):
        bodies.append(free_name(model.body(index).name or f"body {index}", bodies))
    joints: list[str] = []
    for index in range(model.njnt):
        name = model.joint(index).name or f"{bodies[model.jnt_bodyid[index]]} joint"
        joints.append(free_name(name, [*bodies, *joints], " joint"))
    return bodies, joints


def free_name(name: str, taken: list[str], ending: str = " body") -> str:
    """A name that is not taken, with an ending where it is.

    Args:
        name: wanted.
        taken: names in use.
        ending: that is appended.
    """
    if name not in taken:
        return name
    name = f"{name}{ending}"
    return name if name not in taken else f"{name} {len(taken)}"


def not_taken_over(compiled: Compiled, joints: list[str]) -> list[str]:
    """What a model has and the mechanism will not have, in words."""
    model, missing = compiled.model, []
    of_joint = lambda values: [joints[model.dof_jntid[k]] for k in np.flatnonzero(values)]
    ball = model.jnt_type[model.dof_jntid] <= SPHERICAL
    for what, names in (
        ("armature", of_joint((model.dof_armature > 0) & ball)),
        ("dry friction", of_joint((model.dof_frictionloss > 0) & ball)),
        ("damping", of_joint((model.dof_damping > 0) & ball)),
        ("damping that is not linear", of_joint(np.any(model.dof_dampingpoly != 0, axis=-1))),
    ):
        missing += [_of_joints(what, names)] if names else []
    soft = (model.jnt_stiffness > 0) & (model.jnt_type <= SPHERICAL)
    bent = np.any(np.atleast_2d(model.jnt_stiffnesspoly) != 0, axis=-1)
    for what, flags in (
        ("limits", (model.jnt_limited > 0) & ~has_stop(model)),
        ("stiffness", soft),
        ("stiffness that is not linear", bent),
    ):
        missing += (
            [_of_joints(what, [joints[k] for k in np.flatnonzero(flags)])] if any(flags) else []
        )
    if np.any((model.geom_contype > 0) | (model.geom_conaffinity > 0)):
        missing.append("contacts between geometries (bodies pass through each other)")
    if np.any(model.body_gravcomp != 0):
        missing.append("compensation of gravity")
    if model.opt.density > 0 or model.opt.viscosity > 0 or np.any(model.opt.wind != 0):
        missing.append("the fluid around the bodies")
    mocap = [k for k in range(model.nbody) if model.body_mocapid[k] >= 0]
    for what, names_of in (
        ("actuator", [model.actuator(k).name for k in range(model.nu)]),
        ("tendon", [model.tendon(k).name for k in range(model.ntendon)]),
        ("flexible body", [model.flex(k).name for k in range(model.nflex)]),
        ("motion capture of body", [model.body(k).name for k in mocap]),
    ):
        missing += [f"{what} {_quoted_name(name, k)}" for k, name in enumerate(names_of)]
    if compiled.without:
        missing.append(
            f"meshes that MuJoCo finds no file for or cannot read ({listed(compiled.without)})"
        )
    return missing + [f"MuJoCo says: {words.rstrip('.')}" for words in compiled.warned]


def _quoted_name(name: str, k: int) -> str:
    """A name in quotes; of what has none its number in the file."""
    return f'"{name}"' if name else str(k)


def keyframes(model: Any) -> list[str]:
    """Names of the keyframes of a model; of those without one their numbers."""
    return [model.key(k).name or str(k) for k in range(model.nkey)]


def coordinates_at(model: Any, joints: list[str], keyframe: str) -> dict[str, tuple[float, ...]]:
    """Coordinates of joints at a keyframe, by name.

    Those of hinges and slides count from the reference configuration; of balls and free joints they
    are MuJoCo's.

    Args:
        model: MuJoCo's.
        joints: names by index.
        keyframe: its name.

    Raises:
        ValueError: there is no such keyframe.
    """
    names = keyframes(model)
    check_name("keyframe", keyframe, names)
    value, coordinates = model.key_qpos[names.index(keyframe)], {}
    sizes = {FREE: 7, SPHERICAL: 4}
    for k, name in enumerate(joints):
        place, size = int(model.jnt_qposadr[k]), sizes.get(int(model.jnt_type[k]), 1)
        part = slice(place, place + size)
        values = value[part] if size > 1 else value[part] - model.qpos0[part]
        coordinates[name] = tuple(map(float, values))
    return coordinates


def has_stop(model: Any) -> np.ndarray:
    """Which joints have limits that a stop can be: those of one coordinate, some way apart."""
    wide = model.jnt_range[:, 1] - model.jnt_range[:, 0] > 2 * model.jnt_margin
    return (model.jnt_limited > 0) & (model.jnt_type > SPHERICAL) & wide


def _of_joints(what: str, names: list[str]) -> str:
    return f"{what} of {listed(dict.fromkeys(names))}"
