"""Mechanisms of which an accuracy is asked, and how far a run by what is chosen is off."""

import math
from typing import Any, NamedTuple

import jaxclear as jc
from jaxclear.errors.accuracy import bounds_of_run
from tests.rigs.loaded_bearing import loaded_bearing


class Case(NamedTuple):
    """A mechanism, how long it runs [s], and how many times are saved."""

    make: Any
    duration: float
    saves: int


def ideal_chain(links: int = 3) -> jc.Mechanism:
    """Links on pins, let go level: no contact, no loss."""
    names = [f"link {i}" for i in range(links)]
    length, mass = 0.1, 0.15
    ends = [jc.Marker("ground")] + [jc.Marker(name, (length, 0.0)) for name in names[:-1]]
    pins = [
        jc.Connection(jc.joint.Revolute(), end, name) for end, name in zip(ends, names, strict=True)
    ]
    return jc.Mechanism(
        dict.fromkeys(names, jc.Body(mass, mass * length**2 / 12, (length / 2, 0.0))),
        {f"pin {i}": pin for i, pin in enumerate(pins)},
        {"gravity": jc.load.Gravity((0.0, -9.81))},
        start={f"pin {i}": -0.3 * math.pi if i == 0 else 0.1 for i in range(links)},
    )


CASES = {
    "slider-crank": Case(jc.scenes.slider_crank, 0.05, 51),
    "loaded bearing": Case(lambda: loaded_bearing(500.0, jc.friction.Stribeck()), 0.01, 41),
    "ideal chain": Case(ideal_chain, 0.5, 51),
    # On half of its cells, 288, the depth is stated to 1.8 %, as 144 change it by 5.4 %.
    "planar four-bar": Case(lambda: jc.scenes.four_bar("planar", cells=(576, 1)), 0.1, 161),
}
# Bounds of the run that is taken for the truth: coordinates right to nine digits.
TIGHT = jc.integrator.Adaptive(rtol=1e-11, atol=1e-13)


def truth(case: Case) -> Any:
    """The run that is taken for the truth."""
    given = {"save": case.saves, "balance": True, "verify": False}
    return jc.simulate(case.make(), case.duration, integrator=TIGHT, **given)


def share_off(run: Any, exact: Any) -> float:
    """How far the places, mean forces and losses of a run are off: the largest share."""
    asked = bounds_of_run(0.5)
    one, other = asked.observe(run), asked.observe(exact)
    return 0.5 * max(asked.compare(run, one, other).values())
