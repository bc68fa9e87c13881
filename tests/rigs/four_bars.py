"""Four-bars in the plane from the lengths of their links."""

import jaxclear as jc

HINGE = jc.joint.Revolute()


def four_bar(lengths, ground, body, loads=None, drive=None, **how):
    """Links {name: length [m]} from the crank's foot to the other one, which is `ground` [m] away;
    joints O, A, B, D. `body`: of each link, or a function of its length."""
    (first, crank), (second, coupler), (third, rocker) = lengths.items()
    ends = jc.Marker(second, (coupler, 0.0)), jc.Marker(third, (rocker, 0.0))
    make = body if callable(body) else lambda _: body
    return jc.Mechanism(
        {name: make(length) for name, length in lengths.items()},
        {
            "O": jc.Connection(jc.joint.Revolute(drive=drive), "ground", first),
            "A": jc.Connection(HINGE, first, second, at=(crank, 0.0)),
            "B": jc.Connection(HINGE, *ends),
            "D": jc.Connection(HINGE, "ground", third, at=(ground, 0.0)),
        },
        loads,
        **how,
    )


def link(length):
    """A rod of 1 kg whose middle is its centre of mass."""
    return jc.Body(1.0, 1e-3, (0.5 * length, 0.0))
