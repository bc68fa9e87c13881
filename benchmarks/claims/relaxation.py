"""Derivatives through an impact by a relaxed contact law: bias against noise over kappa.

Two closed cases over a second, each step with a complementarity problem, by `InteriorPoint(kappa)`
and, as its limit, by Lemke's method. *Push*: a body of 1 kg that a force drives closes a gap,
strikes another one without rebound and pushes it against drag; impulse and gap at the end of a step
are complementary (Stewart & Trinkle 1996, Int. J. Numer. Methods Eng. 39, 2673). *Rebound*: a ball
flies against a wall and back; where the gap closes within half a step, impulse and Newton's law of
impact are (Moreau). The slope of the last place by the first gap is taken through all steps, over
gaps that differ by many steps' ways, so that impacts fall anywhere in a step. `bias`: mean error of
the slope; `noise`: its standard deviation; both beside the mean slope. `--json
benchmarks/results/relaxation.json` keeps it.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.measure import arguments, report, sign
from tests.rigs.lemke import Lemke

FORCE, DRAG, SPEED, RESTITUTION, DURATION = 4.0, 2.0, 1.0, 0.8, 1.0
GAPS = (0.45, 0.55)
KAPPAS = tuple(10.0**-k for k in range(2, 13))
STEPS = (50, 200)
SAMPLES = 200


def pushed(gap: Any) -> Any:
    """Way of the second body [m]: from their meeting on both go at half the speed of the first,
    then ever nearer to that at which drag takes the force."""
    meeting = jnp.sqrt(2 * gap / FORCE)
    left, last, rate = DURATION - meeting, FORCE / DRAG, DRAG / 2
    return last * left + (FORCE * meeting / 2 - last) / rate * (1 - jnp.exp(-rate * left))


def push(solver: Any, steps: int, gap: Any) -> Any:
    """The same by steps."""
    h = DURATION / steps

    def step(state, _):
        apart, first, second, gone = state
        first, second = first + h * FORCE, second * (1 - h * DRAG)
        free = apart + h * (second - first)
        impulse = solver.solve(jc.complementarity.LCP(jnp.array([[2 * h]]), free[None])).z[0]
        first, second = first - impulse, second + impulse
        return (apart + h * (second - first), first, second, gone + h * second), None

    return jax.lax.scan(step, (gap, 0.0, 0.0, 0.0), None, steps)[0][3]


def returned(gap: Any) -> Any:
    """Place of the ball before the wall [m]."""
    return RESTITUTION * (SPEED * DURATION - gap)


def rebound(solver: Any, steps: int, gap: Any) -> Any:
    """The same by steps."""
    h = DURATION / steps

    def step(state, _):
        apart, speed = state
        law = (1 + RESTITUTION) * speed
        impulse = solver.solve(jc.complementarity.LCP(jnp.eye(1), law[None])).z[0]
        after = jnp.where(apart + 0.5 * h * speed <= 0, speed + impulse, speed)
        return (apart + h * 0.5 * (speed + after), after), None

    return jax.lax.scan(step, (gap, jnp.asarray(-SPEED)), None, steps)[0][0]


CASES: dict[str, tuple[Callable, Callable]] = {
    "push": (pushed, push),
    "rebound": (returned, rebound),
}


@eqx.filter_jit
def slopes(way: Callable, solver: Any, steps: int, gaps: Any) -> tuple[Any, Any]:
    """(places, their slopes by the gap)."""
    return jax.vmap(lambda gap: jax.jvp(lambda g: way(solver, steps, g), (gap,), (1.0,)))(gaps)


def measured(case: str, solver: Any, steps: int, samples: int) -> dict[str, Any]:
    exact, way = CASES[case]
    gaps = jnp.asarray(np.linspace(*GAPS, samples))
    places, found = map(np.asarray, slopes(way, solver, steps, gaps))
    wanted = np.asarray(jax.vmap(jax.grad(exact))(gaps))
    scale = abs(wanted.mean())
    relaxed = isinstance(solver, jc.complementarity.InteriorPoint)
    return {
        "case": case,
        "step [ms]": 1e3 * DURATION / steps,
        "kappa": float(solver.kappa) if relaxed else 0.0,
        "place off by [m]": float(np.abs(places - np.asarray(exact(gaps))).mean()),
        "bias": float((found - wanted).mean() / scale),
        "noise": float((found - wanted).std() / scale),
    }


def main() -> None:
    options = arguments(__doc__)
    counts, samples = (STEPS[:1], 20) if options.quick else (STEPS, SAMPLES)
    solvers = [*map(jc.complementarity.InteriorPoint, KAPPAS), Lemke()]
    for case in CASES:
        rows = [measured(case, own, steps, samples) for steps in counts for own in solvers]
        report(f"Slope through an impact over kappa: {case}", rows, options)
    sign("benchmarks.claims.relaxation", options.json)


if __name__ == "__main__":
    main()
