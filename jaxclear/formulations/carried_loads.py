"""Where a joint that always touches carries its reaction with its friction, and how hard it presses
there.

Friction at the side of a guide adds to the moment that it carries, and so to what it is a share of;
what a journal, a slideway or a ball carries does not hang on friction.
"""

from typing import Any

from jaxclear.components.clearance import CarryingEnd, carried_load
from jaxclear.formulations.permanent_reactions import PermanentJoint, Reaction
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide


def carrying_ends(
    held: PermanentJoint, reaction: Reaction, friction: Any
) -> tuple[CarryingEnd, ...]:
    """Where a reaction and friction [N] (of a ball three components) are carried."""
    if held.joint.components > 1:
        none = (0.0,) * held.joint.components
        load = carried_load(held.joint.carrying_ends(*reaction, none))
        return held.joint.carrying_ends(*reaction, tuple(safe_divide(x, load) for x in friction))
    return held.joint.carrying_ends(*reaction, _share(held, reaction, friction))


def _share(held: PermanentJoint, reaction: Reaction, friction: Any) -> Any:
    """Friction beside the load that it adds to: two turns, and where they lead (Steffensen's
    extrapolation; the load is linear in the share until an end changes its side)."""
    if held.joint.friction is None:
        return 0.0 * friction

    def better(share):
        return safe_divide(friction, carried_load(held.joint.carrying_ends(*reaction, share)))

    first = better(0.0 * friction)
    second = better(first)
    third = better(second)
    step, change = third - second, third - 2 * second + first
    return third - safe_divide(step * step, change)


def pressing(held: PermanentJoint, reaction: Reaction, friction: Any) -> Any:
    """Sum of the normal forces [N] of a joint's contacts."""
    ends = carrying_ends(held, reaction, friction)
    return sp.total(contact.normal_force for end in ends for contact in end.contacts)
