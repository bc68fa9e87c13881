"""jaxclear beside Exudyn and MuJoCo on the planar four-bar, with a closed loop of ideal joints and
with clearance in the joint between coupler and follower: CPU time of as many equal steps.

The mechanism is `jc.scenes.four_bar` in the plane, without wear. Ideal: nothing drives the crank,
which starts at 10 rad/s; the reference is the equation of its angle alone, by scipy. With
clearance: the crank turns at 10 rad/s, the journal starts at rest in the middle of its bearing,
friction grows with the slip from 0, as in Exudyn; the reference is jaxclear's `Adaptive` at a tight
tolerance, and how far the others' finer runs are from it is the agreement. MuJoCo knows no journal
in a hole, so its contact is the same law as a compiled callback. jaxclear is called as a user calls
it, `jc.simulate(..., verify=False)`. What is not installed is left out: `pip install
".[test,peers]"`.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import jaxclear as jc
from benchmarks.measure import run_tables, side_by_side
from benchmarks.peers import programs, with_mujoco
from jaxclear.laws.material import combined_modulus, steel
from jaxclear.scenes.four_bar import BEARING_RADIUS, COUPLER, CRANK, FOLLOWER, GROUND

SPEED, GRAVITY, CLEARANCE = 10.0, 9.81, 0.2e-3
# Length and mass of crank, coupler, follower; all slender.
LINKS = ((CRANK, 0.46), (COUPLER, 1.44), (FOLLOWER, 1.63))
MU, OUTER = 0.1, 1e-2
# Crank's inertia that keeps its speed where a program has no prescribed motion [kg m2].
FLYWHEEL = 1e9
# Seconds, saving times, steps; the agreement is of so many times as many steps.
IDEAL, WITH_CLEARANCE, FINER = (1.0, 100, 2000), (0.1, 100, 10000), 32
TIGHT = 1e-11


class Numbers(NamedTuple):
    """What the compiled contact needs, SI units."""

    crank: float
    coupler: float
    follower: float
    ground: float
    radius: float
    clearance: float
    stiffness: float
    damping: float
    slowest: float
    mu: float
    outer: float


class Case(NamedTuple):
    """Simulated time [s], saving times after the first, steps."""

    duration: float
    saves: int
    steps: int

    @property
    def step(self) -> float:
        return self.duration / self.steps

    @property
    def times(self) -> np.ndarray:
        return np.linspace(0.0, self.duration, self.saves + 1)[1:]


@cache
def ideal() -> jc.Mechanism:
    """The loop of ideal joints, its crank free."""
    scene = jc.scenes.four_bar("ideal")
    free = {"O": jc.Connection(jc.joint.Revolute(), "ground", "crank")}
    return jc.Mechanism(
        bodies=dict(scene.bodies),
        connections=dict(scene.connections) | free,
        loads=dict(scene.loads),
        start={"O": 0.0},
        speeds={"O": SPEED},
        guess=scene.guess,
    )


@cache
def loose() -> jc.Mechanism:
    """The crank driven, clearance in "B"."""
    scene = jc.scenes.four_bar("planar", CLEARANCE, wear=False)
    friction = jc.friction.Ambrosio(mu_kinetic=MU, inner_speed=0.0, outer_speed=OUTER)
    return eqx.tree_at(lambda m: m.connections["B"].joint.friction, scene, friction)


def numbers() -> Numbers:
    """The laws' numbers as jaxclear's defaults have them."""
    contact, inner = loose().connections["B"].joint.contact, BEARING_RADIUS - CLEARANCE
    modulus = combined_modulus(steel(), steel())
    return Numbers(
        CRANK,
        COUPLER,
        FOLLOWER,
        GROUND,
        BEARING_RADIUS,
        CLEARANCE,
        4 / 3 * float(modulus) * math.sqrt(inner * BEARING_RADIUS / CLEARANCE),
        0.75 * (1 - float(contact.restitution) ** 2),
        float(contact.slowest_impact),
        MU,
        OUTER,
    )


@cache
def start(with_clearance: bool) -> tuple[list[float], list[float]]:
    """Angles of the crank, of the coupler relative to it and of the follower [rad], and speeds."""
    joints = ("A", "D") if with_clearance else ("O", "A", "D")
    run = jc.simulate(
        loose() if with_clearance else ideal(),
        1e-3,
        save=2,
        verify=False,
        integrator=jc.integrator.FixedStep(1e-3),
    )
    q, v = ([float(of(name)[0]) for name in joints] for of in (run.coordinate, run.speed))
    return ([0.0, *q], [SPEED, *v]) if with_clearance else (q, v)


# jaxclear


def jaxclear_run(
    mechanism: jc.Mechanism, case: Case, joint: str, integrator: Any
) -> tuple[np.ndarray, int]:
    """(angle of a joint at the saving times [rad], steps)."""
    run = jc.simulate(
        mechanism, case.duration, integrator=integrator, save=case.saves + 1, verify=False
    )
    return np.asarray(run.coordinate(joint))[1:], int(run.accepted_steps + run.rejected_steps)


# The crank's equation alone


def _others(crank):
    """Angles of coupler and follower in the ground, by the triangle over the diagonal."""
    x, y = GROUND - CRANK * jnp.cos(crank), -CRANK * jnp.sin(crank)
    square = x * x + y * y
    diagonal, base = jnp.sqrt(square), jnp.arctan2(y, x)
    at_crank = (COUPLER**2 + square - FOLLOWER**2) / (2 * COUPLER * diagonal)
    at_ground = (FOLLOWER**2 + square - COUPLER**2) / (2 * FOLLOWER * diagonal)
    return base + jnp.arccos(at_crank), base + jnp.pi - jnp.arccos(at_ground)


def _centres(crank):
    """(x, y, angle) of every link at its middle."""
    coupler, follower = _others(crank)
    corner = (CRANK * jnp.cos(crank), CRANK * jnp.sin(crank))
    feet = ((0.0, 0.0, crank), (*corner, coupler), (GROUND, 0.0, follower))
    return jnp.stack(
        [
            jnp.stack([x + 0.5 * length * jnp.cos(a), y + 0.5 * length * jnp.sin(a), a])
            for (x, y, a), (length, _) in zip(feet, LINKS, strict=True)
        ]
    )


def _crank_inertia(crank):
    """Mass of the linkage in the crank's coordinate [kg m2]."""
    rates = jax.jacfwd(_centres)(crank)
    weights = jnp.array([[m, m, m * length**2 / 12] for length, m in LINKS])
    return jnp.sum(weights * rates**2)


def _height(crank):
    return sum(m * GRAVITY * y for (_, m), y in zip(LINKS, _centres(crank)[:, 1], strict=True))


@jax.jit
def _crank_acceleration(crank, speed):
    pull = 0.5 * jax.grad(_crank_inertia)(crank) * speed**2 + jax.grad(_height)(crank)
    return -pull / _crank_inertia(crank)


def crank_alone(case: Case) -> np.ndarray:
    """Angle of the crank of the ideal linkage at the saving times [rad]."""
    solution = solve_ivp(
        lambda t, y: [y[1], float(_crank_acceleration(y[0], y[1]))],
        (0.0, case.duration),
        [0.0, SPEED],
        "DOP853",
        t_eval=case.times,
        rtol=1e-12,
        atol=1e-13,
    )
    return solution.y[0]


# Exudyn


def _exudyn_trees(crank_inertia: float, q: list[float], v: list[float]):
    """(module, items, system, tree of crank and coupler, tree of the follower, follower's and
    crank's node). Coordinates: crank, coupler relative to it; follower."""
    exu = programs.load_exudyn()
    import exudyn.itemInterface as items

    container = exu.SystemContainer()
    mbs = container.AddSystem()
    eye, weight = np.eye(3), [0.0, -GRAVITY, 0.0]

    def tree(links, base, parents, offsets, q, v):
        node = mbs.AddNode(items.NodeGenericODE2("", [0.0] * len(q), q, v, len(q)))
        inertias = [np.diag([0.0, 0.0, i]) for _, _, i in links]
        return node, mbs.AddObject(
            items.ObjectKinematicTree(
                nodeNumber=node,
                gravity=weight,
                baseOffset=base,
                jointTypes=[exu.JointType.RevoluteZ] * len(q),
                linkParents=parents,
                jointTransformations=exu.Matrix3DList([eye] * len(q)),
                jointOffsets=exu.Vector3DList(offsets),
                linkInertiasCOM=exu.Matrix3DList(inertias),
                linkCOMs=exu.Vector3DList([[0.5 * length, 0, 0] for length, *_ in links]),
                linkMasses=[m for _, m, _ in links],
            )
        )

    links = [(length, m, m * length**2 / 12) for length, m in LINKS]
    crank = (*links[0][:2], links[0][2] + crank_inertia)
    first, arm = tree(
        [crank, links[1]], [0, 0, 0], [-1, 0], [[0, 0, 0], [CRANK, 0, 0]], q[:2], v[:2]
    )
    second, follower = tree([links[2]], [GROUND, 0, 0], [-1], [[0, 0, 0]], q[2:], v[2:])
    marker = lambda of, link, at: mbs.AddMarker(
        items.MarkerKinematicTreeRigid(objectNumber=of, linkNumber=link, localPosition=[at, 0, 0])
    )
    return (
        container,
        items,
        mbs,
        marker(follower, 0, FOLLOWER),
        marker(arm, 1, COUPLER),
        first,
        second,
    )


@cache
def _exudyn_system(with_clearance: bool):
    """(container, system, sensor of the compared angle)."""
    q, v = start(with_clearance)
    container, items, mbs, journal, hole, first, second = _exudyn_trees(
        FLYWHEEL if with_clearance else 0.0, q, v
    )
    if with_clearance:
        p = numbers()
        memory = mbs.AddNode(
            items.NodeGenericData(
                initialCoordinates=[p.clearance, 0, 0, 0], numberOfDataCoordinates=4
            )
        )
        mbs.AddObject(
            items.ObjectContactSphereSphere(
                markerNumbers=[journal, hole],
                nodeNumber=memory,
                spheresRadii=[p.radius - p.clearance, p.radius],
                isHollowSphere1=True,
                dynamicFriction=p.mu,
                frictionProportionalZone=p.outer,
                contactStiffness=p.stiffness,
                contactStiffnessExponent=1.5,
                restitutionCoefficient=1 - p.damping / 1.5,
                minimumImpactVelocity=p.slowest,
                impactModel=1,
            )
        )
    else:
        mbs.AddObject(
            items.ObjectJointSpherical(markerNumbers=[journal, hole], constrainedAxes=[1, 1, 0])
        )
    node = second if with_clearance else first
    angle = mbs.AddSensor(
        items.SensorNode(
            nodeNumber=node,
            outputVariableType=programs.load_exudyn().OutputVariableType.Coordinates,
            storeInternal=True,
            writeToFile=False,
        )
    )
    mbs.Assemble()
    return container, mbs, angle


def exudyn_run(case: Case, with_clearance: bool, solver: str, steps: int) -> tuple[np.ndarray, int]:
    exu = programs.load_exudyn()
    _, mbs, angle = _exudyn_system(with_clearance)
    settings = exu.SimulationSettings()
    stepping = settings.timeIntegration
    stepping.endTime, stepping.numberOfSteps = case.duration, steps
    stepping.verboseMode, stepping.adaptiveStep, stepping.automaticStepSize = 0, False, False
    stepping.explicit.computeEndOfStepAccelerations = False
    stepping.discontinuous.useRecommendedStepSize = False
    stepping.newton.relativeTolerance, stepping.newton.absoluteTolerance = 1e-8, 1e-9
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = case.duration / case.saves
    mbs.SolveDynamic(
        settings,
        solverType=getattr(exu.DynamicSolverType, solver),
        showHints=False,
        updateInitialValues=False,
    )
    rows = mbs.GetSensorStoredData(angle)
    at = [int(np.argmin(abs(rows[:, 0] - time))) for time in case.times]
    return rows[at, 1], int(mbs.sys["dynamicSolver"].it.currentStepIndex)


# MuJoCo

CALLBACK = r"""
#define _GNU_SOURCE
#include <math.h>
#include <mujoco/mujoco.h>
typedef struct {
    double crank, coupler, follower, ground, radius, clearance, stiffness, damping, slowest, mu;
    double outer;
} P;
typedef struct { double delta, rate, coupler, follower; } F;

/* Indentation, its rate, and moments about the coupler's and the follower's joints. */
static F contact(const P *p, const double *q, const double *v, double impact)
{
    double b = q[0] + q[1], w = v[0] + v[1], s = v[2];
    double ax = p->crank * cos(q[0]), ay = p->crank * sin(q[0]);
    double lx = p->coupler * cos(b), ly = p->coupler * sin(b);
    double hx = p->follower * cos(q[2]), hy = p->follower * sin(q[2]);
    double ex = p->ground + hx - ax - lx, ey = hy - ay - ly, r = sqrt(ex * ex + ey * ey);
    F f = {r - p->clearance, 0, 0, 0};
    if (r < 1e-9 * p->clearance) return f;
    double vx = -s * hy + v[0] * ay + w * ly, vy = s * hx - v[0] * ax - w * lx;
    double nx = ex / r, ny = ey / r;
    f.rate = nx * vx + ny * vy;
    if (f.delta <= 0) return f;
    double loss = 1 + p->damping * f.rate / fmax(impact, p->slowest);
    double normal = p->stiffness * f.delta * sqrt(f.delta) * fmax(loss, 0);
    double reach = p->radius + 0.5 * f.delta;
    double slip = nx * vy - ny * vx + s * (reach - r) - w * reach;
    double drag = -copysign(p->mu * fmin(fabs(slip) / p->outer, 1), slip) * normal;
    double fx = -normal * nx - drag * ny, fy = -normal * ny + drag * nx;
    double x = lx + reach * nx, y = ly + reach * ny;
    f.coupler = -(x * fy - y * fx);
    x += ax - p->ground;
    y += ay;
    f.follower = x * fy - y * fx;
    return f;
}

/* userdata: impact speed; gap and rate when last open; whether closed */
void passive(const mjModel *m, mjData *d)
{
    const P *p = (const P *)m->numeric_data;
    double *s = d->userdata;
    F f = contact(p, d->qpos, d->qvel, s[0]);
    if (f.delta <= 0) {
        s[0] = s[2] = f.rate;
        s[1] = f.delta;
        s[3] = 0;
        return;
    }
    if (s[3] == 0) {
        s[0] = s[2] - (f.rate - s[2]) * s[1] / (f.delta - s[1]);
        s[3] = 1;
        f = contact(p, d->qpos, d->qvel, s[0]);
    }
    d->qfrc_passive[1] += f.coupler;
    d->qfrc_passive[2] += f.follower;
}
"""
MODEL = """
<mujoco>
  <option integrator="RK4" timestep="{step!r}" gravity="0 {gravity} 0"/>
  <size nuserdata="4"/>
  <custom><numeric name="rig" data="{numbers}"/></custom>
  <worldbody>
    <body>
      <joint type="hinge" axis="0 0 1" armature="{flywheel}"/>
      {crank}
      <body name="coupler" pos="{place} 0 0"><joint type="hinge" axis="0 0 1"/>{coupler}</body>
    </body>
    <body name="follower" pos="{ground} 0 0"><joint type="hinge" axis="0 0 1"/>{follower}</body>
  </worldbody>
  {loop}
</mujoco>
"""
LOOP = """<equality>
    <connect body1="coupler" body2="follower" anchor="{at} 0 0" solref="{time!r} 1"
             solimp="0.9999 0.9999 1e-3"/>
  </equality>"""


@cache
def _mujoco_model(step: float, with_clearance: bool):
    import mujoco

    inertial = [
        f'<inertial pos="{0.5 * length} 0 0" mass="{m}" diaginertia="{i} {i} {i}"/>'
        for length, m, i in [(length, m, m * length**2 / 12) for length, m in LINKS]
    ]
    # The anchor is where the bodies meet as drawn, so the loop is drawn closed there.
    loop = "" if with_clearance else LOOP.format(at=COUPLER, time=2 * step)
    text = MODEL.format(
        step=step,
        gravity=-GRAVITY,
        numbers=" ".join(f"{number:.17g}" for number in numbers()),
        flywheel=FLYWHEEL if with_clearance else 0.0,
        place=CRANK,
        ground=GROUND,
        crank=inertial[0],
        coupler=inertial[1],
        follower=inertial[2],
        loop=loop,
    )
    model = mujoco.MjModel.from_xml_string(text)
    if not with_clearance:
        # Anchor on the follower's tip, not where the drawing has it.
        model.eq_data[0, 3:6] = (FOLLOWER, 0.0, 0.0)
    return model


def mujoco_run(case: Case, with_clearance: bool, steps: int) -> tuple[np.ndarray, int]:
    import mujoco

    q, v = start(with_clearance)
    model = _mujoco_model(case.duration / steps, with_clearance)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = q, v
    data.userdata[:] = [0.0, -CLEARANCE, 0.0, 0.0]
    angles, coordinate = np.empty(case.saves), 2 if with_clearance else 0
    for save in range(case.saves):
        mujoco.mj_step(model, data, steps // case.saves)
        angles[save] = data.qpos[coordinate]
    return angles, steps


# Tables


def _rows(
    case: Case, reference: np.ndarray, runs: dict[str, Callable[[int], tuple[np.ndarray, int]]]
) -> list[dict[str, Any]]:
    """Each program with as many steps, the first beside the others; off: from the reference, also
    of a finer run (of `Adaptive` at a tight tolerance)."""
    first = next(iter(runs))
    spent = side_by_side({name: lambda run=run: run(case.steps) for name, run in runs.items()}, 3)
    rows = []
    for name, run in runs.items():
        (angles, steps), (fine, _) = run(case.steps), run(FINER * case.steps)
        rows.append(
            {
                "program": name,
                "steps": steps,
                "off [rad]": float(np.abs(angles - reference).max()),
                f"off, {FINER} times the steps [rad]": float(np.abs(fine - reference).max()),
                "CPU [ms]": 1e3 * spent[name][1],
                "CPU / jaxclear": spent[name][1] / spent[first][1],
                "CPU ns/step": 1e9 * spent[name][1] / steps,
            }
        )
    return rows


def _fixed(case: Case, steps: int) -> Any:
    return jc.integrator.FixedStep(case.duration / steps)


def ideal_rows(options: Any) -> list[dict[str, Any]]:
    case = Case(*IDEAL)
    runs = {"jaxclear FixedStep": lambda n: jaxclear_run(ideal(), case, "O", _fixed(case, n))}
    if programs.installed("exudyn"):
        runs["Exudyn GeneralizedAlpha"] = lambda n: exudyn_run(case, False, "GeneralizedAlpha", n)
    if programs.installed("mujoco"):
        runs["MuJoCo C RK4, loop by a soft constraint"] = lambda n: mujoco_run(case, False, n)
    return _rows(case, crank_alone(case), runs)


def loose_rows(options: Any) -> list[dict[str, Any]]:
    case = Case(*WITH_CLEARANCE)
    tight, finer = (jc.integrator.Adaptive(rtol=r, atol=1e-2 * r) for r in (TIGHT, 10 * TIGHT))
    reference, _ = jaxclear_run(loose(), case, "D", tight)
    runs = {
        "jaxclear FixedStep": lambda n: jaxclear_run(loose(), case, "D", _fixed(case, n)),
        "jaxclear Adaptive, as many steps as it takes": lambda n: jaxclear_run(
            loose(), case, "D", jc.integrator.Adaptive() if n == case.steps else finer
        ),
    }
    if programs.installed("exudyn"):
        for solver in ("ExplicitMidpoint", "RK44"):
            runs[f"Exudyn {solver}"] = lambda n, solver=solver: exudyn_run(case, True, solver, n)
    if programs.installed("mujoco") and with_mujoco.install(CALLBACK):
        runs["MuJoCo C RK4, contact as a compiled callback"] = lambda n: mujoco_run(case, True, n)
    return _rows(case, reference, runs)


if __name__ == "__main__":
    run_tables(
        {
            "four-bar of ideal joints, equal steps": ideal_rows,
            "four-bar with clearance, equal steps": loose_rows,
        }
    )
