"""What a beam does over a run: how it bends, and what its outer fibre bears."""

from typing import Any, Literal

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.beam import Beam, piece_name
from jaxclear.ground.arguments import check_name

LINES = ("chord", "start")


def _find_beam(run: Any, name: str) -> Beam:
    beams = {n: b for n, b in run.mechanism.bodies.items() if isinstance(b, Beam)}
    check_name("beam", name, beams, " in this mechanism")
    return beams[name]


def beam_deflection(
    run: Any, name: str, relative_to: Literal["chord", "start"]
) -> Float[Array, "time place 3"]:
    """See `Trajectory.deflection`.

    Args:
        run: trajectory of the mechanism.
        name: of the beam.
        relative_to: "chord" between its ends, or "start": the tangent at its first end.
    """
    beam = _find_beam(run, name)
    check_name("line in relative_to", relative_to, LINES)
    ends = beam.ends()
    pieces = [run.body(piece_name(name, i)) for i in range(len(ends) - 1)]
    tip = pieces[-1].origin + (ends[-1] - ends[-2]) * pieces[-1].rotation[:, :, 0]
    points = jnp.stack([*(piece.origin for piece in pieces), tip], axis=1)
    away = points - points[:, :1]
    axes = pieces[0].rotation
    if relative_to == "chord":
        along = away[:, -1] / jnp.linalg.norm(away[:, -1], axis=-1, keepdims=True)
        across = axes[:, :, 1] - jnp.sum(axes[:, :, 1] * along, axis=-1)[:, None] * along
        across = across / jnp.linalg.norm(across, axis=-1, keepdims=True)
        axes = jnp.stack([along, across, jnp.cross(along, across)], axis=-1)
    local = jnp.einsum("tji,tpj->tpi", axes, away)
    return local - jnp.stack([jnp.asarray(ends), *jnp.zeros((2, len(ends)))], axis=-1)


def beam_stress(run: Any, name: str) -> Float[Array, "time element"]:
    """See `Trajectory.stress`."""
    beam = _find_beam(run, name)
    element = beam.length / beam.segments
    strain: dict[str, Any] = {"bend_y": 0.0, "bend_z": 0.0, "stretch": 0.0}
    for kind in {hinge.kind for hinge in beam.hinges(name)} & set(strain):
        joints = [hinge.joint for hinge in beam.hinges(name) if hinge.kind == kind]
        strain[kind] = jnp.stack([run.coordinate(joint) for joint in joints], axis=1) / element
    bending = beam.section.outer_strain(strain["bend_z"], strain["bend_y"])
    if bending is None or beam.material is None:
        raise ValueError(
            f'the beam "{name}" has a section given by its stiffness, without an outer fibre; '
            "give its shape, such as jaxclear.section.Circle, to read its stress."
        )
    return beam.material.young_modulus * (bending + abs(strain["stretch"]))
