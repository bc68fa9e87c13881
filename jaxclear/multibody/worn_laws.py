"""Contact laws on worn surfaces: where a surface asks for it (`Wearing.worn_radius`), what a law
takes from the geometry (stiffness, radii, clearance) is fitted anew, to the radii at the contact.

A bearing or socket worn by h has the radius R + h there, a journal or ball R - h; so the clearance
grows by both. The gap itself is that of the worn surface anyway. Source: Hou, Deng & Zeng 2021, J.
Cent. South Univ. 28, 712, doi:10.1007/s11771-021-4640-y, where the curvature radius of a worn
element is the socket's radius and the element's depth.
"""

from typing import Any

import jax

from jaxclear.components.clearance import AbstractClearance, ContactLaws
from jaxclear.ground import sparse as sp
from jaxclear.laws.stiffness import AbstractFit, Shape, fitted


def fitted_laws(joint: AbstractClearance) -> tuple[ContactLaws, ...]:
    """Laws of each possible contact of a joint as its unworn shape has them; with those before
    fitting where a surface counts with its worn radius."""
    follows = any(wearing.worn_radius for _, wearing in joint.maps().values())
    return tuple(
        own._replace(
            contact=fitted(own.contact, own.shape),
            unfitted=own.contact if follows and own.wears else None,
        )
        for own in joint.contact_laws()
    )


def check_followed(joint: AbstractClearance) -> None:
    """Raises `ValueError`, with a sentence that goes behind the joint's name, where a surface
    counts with its worn radius and no contact law there takes a number from the radii."""
    follows = [name for name, (_, wearing) in joint.maps().items() if wearing.worn_radius]
    fits = (
        isinstance(node, AbstractFit) and _asks_for_radii(node, own.shape)
        for own in joint.contact_laws()
        if own.wears
        for node in jax.tree.leaves(own.contact, is_leaf=lambda x: isinstance(x, AbstractFit))
    )
    if follows and not any(fits):
        raise ValueError(
            f"the wear of its {follows[0]} has worn_radius=True, but no number of its contact law "
            "follows from the radii, so nothing would change; give the law such a number "
            "(stiffness=jaxclear.stiffness.HertzStiffness(...), say) or leave worn_radius out."
        )


def _asks_for_radii(fit: AbstractFit, shape: Shape) -> bool:
    """Whether a number follows from the radii: not from the materials or the length alone."""
    value = lambda inner, outer: fit.value(Shape(inner, outer, shape.length))
    program = jax.make_jaxpr(value)(shape.inner_radius, shape.outer_radius).jaxpr
    used = [x for equation in program.eqns for x in equation.invars] + program.outvars
    return any(x is radius for x in used for radius in program.invars)


def laws_now(
    joint: AbstractClearance,
    laws: tuple[ContactLaws, ...],
    offset: sp.Vec,
    axes: tuple[sp.Vec, ...],
    worn: dict[str, Any],
) -> tuple[ContactLaws, ...]:
    """The laws at each possible contact of a joint whose surfaces are worn as they are: the given
    ones where none counts with its worn radius."""
    counted = [name for name, (_, w) in joint.maps().items() if w.worn_radius and name in worn]
    if not counted:
        return laws
    unworn = joint.indentations(offset, axes, {})
    outer: list[Any] = [0.0] * len(laws)
    inner: list[Any] = [0.0] * len(laws)
    for name in counted:
        of_part = inner if name in joint.inner_surfaces() else outer
        there = joint.indentations(offset, axes, {name: worn[name]})
        for k, (before, after) in enumerate(zip(unworn, there, strict=True)):
            of_part[k] = of_part[k] + before - after
    found = []
    for own, lost, gone in zip(laws, outer, inner, strict=True):
        if own.unfitted is not None:
            shape = own.shape
            radii = shape.inner_radius - gone, shape.outer_radius + lost
            own = own._replace(contact=fitted(own.unfitted, Shape(*radii, shape.length)))
        found.append(own)
    return tuple(found)
