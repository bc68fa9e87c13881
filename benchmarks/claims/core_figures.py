"""The engine's core figures, one program each, for `before_after`: steps of every rung, studies,
derivatives, complementarity.

Runs under any checkout: it uses only names that are public in all of them, and is started as a
file with PYTHONPATH naming the checkout. It reads requests from its standard input, one a line,
and answers each with one line of JSON: `prepare NAME` compiles and gives the CPU seconds of a
call, `time NAME COUNT` the CPU seconds of that many calls, `list` the names.
"""

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc

BATCH = 64
SAVES = 11
KINDS = jc.integrator
# (integrator, simulated time [s]): some hundred to some thousand steps a call.
RUNGS: dict[str, tuple[Callable, float]] = {
    "FixedStep rk4": (lambda: KINDS.FixedStep(2e-5), 0.02),
    # One evaluation of the equations of motion a step.
    "FixedStep semi_implicit": (lambda: KINDS.FixedStep(2e-5, "semi_implicit"), 0.02),
    "ImplicitStep": (lambda: KINDS.ImplicitStep(1e-4), 0.05),
    "Adaptive": (lambda: KINDS.Adaptive(), 0.02),
    "MoreauJean": (lambda: KINDS.MoreauJean(1e-4), 0.05),
    "NonColliding": (lambda: KINDS.NonColliding(1e-3), 0.2),
}
# Laws of the guide and of the antenna are set-valued unless force laws are asked for.
SET_VALUED = ("MoreauJean", "NonColliding")


def slider_crank() -> jc.Mechanism:
    """The mechanism of `jaxclear.scenes.slider_crank`, written out: older checkouts lack it."""
    steel = jc.Material(young_modulus=207e9, poisson_ratio=0.3)
    bearing = jc.clearance.PlanarJournalBearing(
        jc.contact.LankaraniNikravesh(
            stiffness=jc.stiffness.HertzStiffness(steel, steel), restitution=0.9
        ),
        jc.friction.Ambrosio(mu_kinetic=0.03),
        bearing_radius=10e-3,
        clearance=0.2e-3,
    )
    crank = jc.joint.Revolute(drive=jc.drive.ConstantSpeed(50.0))
    along = (jc.Marker("ground", axis="x"), jc.Marker("slider", axis="x"))
    return jc.Mechanism(
        {
            "crank": jc.Body(0.3, 1e-4, (0.025, 0.0)),
            "rod": jc.Body(0.21, 2.5e-4, (0.06, 0.0)),
            "slider": jc.Body(0.14, 1e-4),
        },
        {
            "O": jc.Connection(crank, "ground", "crank"),
            "A": jc.Connection(jc.joint.Revolute(), "crank", "rod", at=(0.05, 0.0)),
            "B": jc.Connection(bearing, "rod", "slider", at=(0.12, 0.0)),
            "G": jc.Connection(jc.joint.Prismatic(), *along),
        },
        {"gravity": jc.load.Gravity((0.0, -9.81))},
        start={"G": 0.17},
    )


def mechanism(scene: str, rung: str) -> jc.Mechanism:
    """A ready mechanism with laws that suit the rung."""
    if scene == "slider-crank":
        return slider_crank()
    if scene == "four-bar":
        return jc.scenes.four_bar(wear=rung != "NonColliding")  # which knows no wear yet
    friction = "set_valued" if rung in SET_VALUED else "regularised"
    if scene == "guide":
        return jc.scenes.guide(clearance=1e-5, friction=friction)
    # A spatial antenna is free to tilt unless its joints always touch.
    kind = "spatial" if rung == "NonColliding" else "planar"
    return jc.scenes.antenna(kind, friction=friction)


JOINTS = {"slider-crank": "B", "four-bar": "B", "guide": None, "antenna": None}


def last_state(run: Any) -> Any:
    """Something that needs the whole run."""
    return run.states[-1, 0]


def problem(scene: str, rung: str) -> jc.Problem:
    """One mechanism on one rung, a clearance that varies."""
    make, duration = RUNGS[rung]
    rig = mechanism(scene, rung)
    joint = JOINTS[scene] or next(iter(rig.topology.clearances))
    clearance = lambda rig: rig.connections[joint].joint.clearance
    varied = {"clearance": jc.Variable(clearance, tolerance=1e-6)}
    return jc.Problem(
        rig, {"end": last_state}, varied, duration=duration, save=SAVES, integrator=make()
    )


def one_run(scene: str, rung: str) -> Callable[[], Any]:
    asked = problem(scene, rung)
    go = eqx.filter_jit(lambda p, v: p.evaluate(v).responses)
    value = asked.nominal()
    return lambda: go(asked, value)


def batch(scene: str, rung: str) -> Callable[[], Any]:
    asked = problem(scene, rung)
    numbers, rest = eqx.partition(asked, eqx.is_array)

    @jax.jit
    def go(numbers, values):
        asked = eqx.combine(numbers, rest)
        return jax.vmap(lambda v: asked.evaluate(v).responses)(values)

    spread = 1 + 0.2 * jnp.linspace(-1.0, 1.0, BATCH)
    values = spread[:, None] * jnp.asarray(asked.nominal())
    return lambda: go(numbers, values)


def slope(rung: str) -> Callable[[], Any]:
    """A pathwise derivative of one run, by the clearance."""
    asked = problem("slider-crank", rung)
    value = asked.nominal()
    answer = lambda v: asked.evaluate(v, discrete_derivatives=True).responses
    go = jax.jit(jax.jacfwd(answer))
    return lambda: go(value)


def study() -> Callable[[], Any]:
    asked = problem("four-bar", "FixedStep rk4")
    return lambda: jc.monte_carlo(asked, samples=2 * BATCH, chunk=BATCH).responses["end"]


def simulated(rung: str) -> Callable[[], Any]:
    """`simulate` as a user calls it, everything included but compilation."""
    rig, (make, duration) = slider_crank(), RUNGS[rung]
    integrator = make()
    return lambda: jc.simulate(rig, 0.1 * duration, save=SAVES, integrator=integrator).states


def solver(name: str, n: int = 8, count: int = 64) -> Callable[[], Any]:
    """Random linear complementarity problems, positive definite, one after the other."""
    library = jc.complementarity
    rng = np.random.default_rng(n)
    half = rng.normal(size=(count, n, n))
    matrices = jnp.asarray(half @ half.transpose(0, 2, 1) + 0.1 * np.eye(n))
    offsets, method = jnp.asarray(rng.normal(size=(count, n))), getattr(library, name)()
    go = eqx.filter_jit(lambda m, q: jax.lax.map(lambda p: method.solve(library.LCP(*p)).z, (m, q)))
    return lambda: go(matrices, offsets)


def sweeps(count: int = 2, number: int = 64) -> Callable[[], Any]:
    """Spatial contacts with friction by projected Gauss-Seidel."""
    library, n = jc.complementarity, 3 * count
    rng = np.random.default_rng(count)
    half = rng.normal(size=(number, n, n))
    parts = half @ half.transpose(0, 2, 1), rng.normal(size=(number, n))
    data = tuple(map(jnp.asarray, (*parts, rng.uniform(0.1, 0.5, (number, count)))))
    method = library.ProjectedGaussSeidel(max_sweeps=200)
    solve = lambda p: method.solve(library.FrictionContact(*p)).residual
    go = eqx.filter_jit(lambda *p: jax.lax.map(solve, p))
    return lambda: go(*data)


def figures() -> dict[str, Callable[[], Callable[[], Any]]]:
    """Every figure by name: a function that builds the call to be timed."""
    found: dict[str, Callable] = {}
    for scene in JOINTS:
        for rung in RUNGS:
            if scene in ("guide", "antenna") and rung.endswith("semi_implicit"):
                continue
            found[f"{scene}, {rung}, alone"] = lambda s=scene, r=rung: one_run(s, r)
            found[f"{scene}, {rung}, batch"] = lambda s=scene, r=rung: batch(s, r)
    for rung in ("FixedStep semi_implicit", "ImplicitStep"):
        found[f"derivative, slider-crank, {rung}"] = lambda r=rung: slope(r)
    for rung in ("FixedStep rk4", "Adaptive"):
        found[f"simulate, slider-crank, {rung}"] = lambda r=rung: simulated(r)
    found["monte carlo, four-bar, FixedStep rk4"] = study
    found["complementarity, InteriorPoint"] = lambda: solver("InteriorPoint")
    found["complementarity, ProjectedGaussSeidel"] = sweeps
    return found


def timed(call: Callable[[], Any], count: int) -> float:
    """CPU seconds of `count` calls."""
    start = time.process_time()
    for _ in range(count):
        jax.block_until_ready(call())
    return time.process_time() - start


def main() -> None:
    """Answers requests until the input ends."""
    known, ready = figures(), {}
    for line in sys.stdin:
        word, _, rest = line.strip().partition(" ")
        name, _, count = rest.partition("\t")
        try:
            if word == "list":
                answer: Any = list(known)
            elif word == "prepare":
                ready = {name: known[name]()}  # one at a time: what is done is forgotten
                timed(ready[name], 1)
                answer = timed(ready[name], 2) / 2
            else:
                answer = timed(ready[name], int(count))
        except Exception as error:  # the other checkout may still have the figure
            answer = f"{type(error).__name__}: {error}"
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
