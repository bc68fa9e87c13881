r"""A mechanism that is warmer than its drawing: every length of a body grows by its material's
expansion, and a clearance by the difference of what lies on either side of it.

$R_B' = R_B (1 + \alpha_B \Delta T)$, $R_J' = R_J (1 + \alpha_J \Delta T)$, $c' = R_B' - R_J'$.
Dimensions of a drawing hold at 20 °C (ISO 1:2022).
"""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax

from jaxclear.components.beam import beam_of, whole_bodies
from jaxclear.components.body import GROUND, Body, Marker
from jaxclear.components.clearance import AbstractClearance
from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_name, check_number, expect
from jaxclear.multibody.mechanism import Mechanism


@answering
def apply_thermal_expansion(mechanism: Mechanism, rise: Any, expansion: Any) -> Mechanism:
    """Change the dimensions of a mechanism by thermal expansion.

    Places of markers and centres of mass grow with their body; a bearing with the body of the
    connection's parent, its journal, ball or slider with that of the child. Masses, inertias,
    stiffnesses and centres of mass of a beam's segments stay. Pure, so that the rise may be a
    `jaxclear.Condition`.

    Args:
        mechanism: the mechanism as drawn.
        rise: temperature rise above that of the drawing [K].
        expansion: coefficient of linear expansion [1/K], one number for all bodies and the ground,
            or a dict by body (0 for what is not named, the ground too): steel some 11.5e-6,
            aluminium 23e-6 (Ashby 2011, Materials Selection in Mechanical Design, 4th ed., appendix
            A).

    Returns:
        the mechanism at that temperature.

    Raises:
        ValueError: for the name of a body that does not exist, or a joint that does not say how it
            grows.
    """
    expect(mechanism, Mechanism, "what expands", "a jaxclear.Mechanism")
    check_number("rise of apply_thermal_expansion", rise, "K")
    values = [GROUND, *whole_bodies(mechanism.bodies)]
    if isinstance(expansion, Mapping):
        for name, value in expansion.items():
            check_name("body", name, values, " in this mechanism")
            check_number(f'expansion of body "{name}"', value, "1/K")
        part = expansion
    else:
        check_number("expansion of apply_thermal_expansion", expansion, "1/K")
        part = dict.fromkeys(values, expansion)
    growth = {
        name: 1 + part.get(beam_of(mechanism.bodies, name), 0.0) * rise for name in mechanism.bodies
    } | {GROUND: 1 + part.get(GROUND, 0.0) * rise}

    def grown_marker(thing):
        if not isinstance(thing, Marker) or thing.at is None:
            return thing
        factor = growth[thing.body]
        return eqx.tree_at(lambda m: m.at, thing, tuple(factor * x for x in thing.at))

    warm = jax.tree.map(grown_marker, mechanism, is_leaf=lambda x: isinstance(x, Marker))
    for name, body in dict.items(mechanism.bodies):
        if isinstance(body, Body) and body.com is not None:
            com = tuple(growth[name] * x for x in body.com)
            warm = eqx.tree_at(_field_reader("bodies", name, "com"), warm, com)
    for name in mechanism.topology.clearances:
        connection = mechanism.connections[name]
        factors = growth[connection.parent.body], growth[connection.child.body]
        joint: AbstractClearance = connection.joint.grown(*factors)
        warm = eqx.tree_at(_field_reader("connections", name, "joint"), warm, joint)
    return warm


def _field_reader(part: str, name: str, field: str) -> Callable[[Mechanism], Any]:
    return lambda mechanism: getattr(getattr(mechanism, part)[name], field)
