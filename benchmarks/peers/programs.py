"""The slider-crank of `peers.rig` in other programs without a mechanism of ours: scipy with numba's
right-hand side, and Exudyn.

scipy stops at every touch and every opening, so it holds the impact speed exactly; at tight
tolerance it is the reference of each law. Exudyn's ball in a hollow sphere is, in planar motion, a
journal in a bearing; its Hunt-Crossley law is Lankarani and Nikravesh's with 1.5 (1 - e') = 0.75 (1
- e^2), its friction is linear from 0 to the regularisation speed.
"""

import importlib.util
import math
import multiprocessing
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import cache

import numba
import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from benchmarks.by_hand.slider_crank import _forces
from benchmarks.peers import rig
from benchmarks.peers.rig import Answer

# Places in a closed contact at which its force is looked at.
LOOKS = 400
# A contact's opening or a flight's end is seen where steps are no longer than this [s].
CONTACT_STEP, FLIGHT_STEP = 1e-5, 3e-5
# Shorter by this for the reference.
FINER = 0.3
# Exudyn: inertia [kg m2] that keeps the crank's speed, spacing of recorded forces [s], and the
# smallest step it may halve to.
FLYWHEEL, RECORD, SMALLEST_STEP = 1e9, 2.5e-6, 1e-14
# Its adaptive runs take no longer steps than this [s].
LONGEST_EXUDYN = 5e-6
MISSING = {"exudyn": "Exudyn", "mujoco": "MuJoCo", "mujoco.mjx": "MJX"}
PIP = {"exudyn": "exudyn", "mujoco": "mujoco", "mujoco.mjx": "mujoco-mjx"}


def installed(module: str) -> bool:
    """Whether a program is there; prints what would bring it if not."""
    parent = module.split(".")[0]
    if (
        importlib.util.find_spec(parent) is not None
        and importlib.util.find_spec(module) is not None
    ):
        return True
    print(
        f"{MISSING[module]} is not installed and is left out; `pip install {PIP[module]}` brings "
        "it."
    )
    return False


@numba.njit(error_model="numpy")
def _slope(t, y, p, c, k, impact):
    angle = p.speed * t
    f = _forces(p, c, k, math.cos(angle), math.sin(angle), y[0], y[1], y[2], y[3], impact)
    return np.array([y[2], y[3], f[0], f[1]])


@numba.njit(error_model="numpy")
def _contact(t, y, p, c, k, impact):
    """(indentation, its rate, normal force)."""
    angle = p.speed * t
    f = _forces(p, c, k, math.cos(angle), math.sin(angle), y[0], y[1], y[2], y[3], impact)
    return f[2:]


def scipy_run(
    law: str, question: rig.Question, method: str, rtol: float, finer: float = 1.0
) -> Answer:
    """Flights and contacts by turns, each solved for itself. `steps` counts evaluations."""
    p, c = rig.LAWS[law], rig.CLEARANCE
    stiffness = rig.stiffness(c)
    t, closed, impact = 0.0, False, 0.0
    y = np.array([0.0, p.crank + p.rod, -p.crank * p.speed / p.rod, 0.0])
    places, times, peak, count = np.empty(question.saves), question.times, 0.0, 0
    while t < question.duration:
        k, longest = (stiffness, CONTACT_STEP) if closed else (0.0, FLIGHT_STEP)

        def gap(t, y, p, c, k, impact):
            return _contact(t, y, p, c, k, impact)[0]

        gap.terminal, gap.direction = True, -1.0 if closed else 1.0
        found = solve_ivp(
            _slope,
            (t, question.duration),
            y,
            method,
            dense_output=True,
            events=gap,
            args=(p, c, k, impact),
            rtol=rtol,
            atol=rig.ATOL_SHARE * rtol,
            max_step=finer * longest,
            first_step=min(1e-9, question.duration - t),
        )
        count += found.nfev
        inside = (times > t) & (times <= found.t[-1])
        if inside.any():
            places[inside] = found.sol(times[inside])[1]
        if closed:
            looks = np.linspace(t, found.t[-1], LOOKS)
            states = zip(looks, found.sol(looks).T, strict=True)
            peak = max(peak, *(_contact(s, z, p, c, k, impact)[2] for s, z in states))
        t, y = found.t[-1], found.y[:, -1].copy()
        if found.status == 1:
            closed = not closed
            if closed:
                impact = _contact(t, y, p, c, k, impact)[1]
    return Answer(places, peak, count)


@cache
def reference(law: str, question: rig.Question) -> tuple[Answer, float]:
    """The law's solution, and how far a second method is from it [m]."""
    first = scipy_run(law, question, "DOP853", rig.REFERENCE_RTOL, FINER)
    second = scipy_run(law, question, "Radau", rig.SECOND_RTOL, FINER)
    return first, float(np.abs(first.places - second.places).max())


def scipy_programs(question: rig.Question) -> list[rig.Program]:
    """The two methods that come out fastest."""
    law, ladder = "captured", rig.tolerance_ladder(1e-5, 1e-12)
    return [
        rig.Program(
            f"scipy {m} + numba",
            law,
            ladder,
            lambda r, m=m: scipy_run(law, question, m, r),
            adaptive=True,
        )
        for m in ("LSODA", "DOP853")
    ]


@cache
def load_exudyn():
    """The module without range checks, imported quietly."""
    sys.exudynFast = True
    import exudyn

    return exudyn


def _exudyn_trees(exu, items, mbs, p):
    """Crank and rod, and the slider, as kinematic trees in joint coordinates: (rod's tree, slider's
    tree, slider's node).
    """
    eye = np.eye(3)
    start = [p.speed, -p.crank * p.speed / p.rod - p.speed]
    swing = mbs.AddNode(items.NodeGenericODE2("", [0.0, 0.0], [0.0, 0.0], start, 2))
    slide = mbs.AddNode(items.NodeGenericODE2("", [0.0], [p.crank + p.rod], [0.0], 1))
    inertias = [np.diag([1.0, 1.0, FLYWHEEL]), rig.ROD_INERTIA * eye]
    tree = mbs.AddObject(
        items.ObjectKinematicTree(
            nodeNumber=swing,
            jointTypes=[exu.JointType.RevoluteZ] * 2,
            linkParents=[-1, 0],
            jointTransformations=exu.Matrix3DList([eye, eye]),
            jointOffsets=exu.Vector3DList([[0, 0, 0], [p.crank, 0, 0]]),
            linkInertiasCOM=exu.Matrix3DList(inertias),
            linkCOMs=exu.Vector3DList([[0, 0, 0], [p.rod / 2, 0, 0]]),
            linkMasses=[1.0, rig.ROD_MASS],
        )
    )
    block = mbs.AddObject(
        items.ObjectKinematicTree(
            nodeNumber=slide,
            jointTypes=[exu.JointType.PrismaticX],
            linkParents=[-1],
            jointTransformations=exu.Matrix3DList([eye]),
            jointOffsets=exu.Vector3DList([[0, 0, 0]]),
            linkInertiasCOM=exu.Matrix3DList([1e-4 * eye]),
            linkCOMs=exu.Vector3DList([[0, 0, 0]]),
            linkMasses=[p.slider],
        )
    )
    return tree, block, slide


@cache
def _exudyn_system(clearance: float):
    """(container, system, sensor of the slider's place, sensor of the contact force)."""
    exu, p = load_exudyn(), rig.LAWS["captured, friction from 0"]
    import exudyn.itemInterface as items

    container = exu.SystemContainer()
    mbs = container.AddSystem()
    tree, block, slide = _exudyn_trees(exu, items, mbs, p)
    ball = mbs.AddMarker(
        items.MarkerKinematicTreeRigid(objectNumber=block, linkNumber=0, localPosition=[0, 0, 0])
    )
    hole = mbs.AddMarker(
        items.MarkerKinematicTreeRigid(objectNumber=tree, linkNumber=1, localPosition=[p.rod, 0, 0])
    )
    memory = mbs.AddNode(
        items.NodeGenericData(initialCoordinates=[clearance, 0, 0, 0], numberOfDataCoordinates=4)
    )
    contact = mbs.AddObject(
        items.ObjectContactSphereSphere(
            markerNumbers=[ball, hole],
            nodeNumber=memory,
            spheresRadii=[p.radius - clearance, p.radius],
            isHollowSphere1=True,
            dynamicFriction=p.mu,
            frictionProportionalZone=p.outer,
            contactStiffness=rig.stiffness(clearance),
            contactStiffnessExponent=1.5,
            restitutionCoefficient=1 - p.damping / 1.5,
            minimumImpactVelocity=p.slowest,
            impactModel=1,
        )
    )
    kinds, kept = exu.OutputVariableType, {"storeInternal": True, "writeToFile": False}
    place = mbs.AddSensor(
        items.SensorNode(nodeNumber=slide, outputVariableType=kinds.Coordinates, **kept)
    )
    force = mbs.AddSensor(
        items.SensorObject(objectNumber=contact, outputVariableType=kinds.Force, **kept)
    )
    mbs.Assemble()
    return container, mbs, place, force


def exudyn_run(question: rig.Question, clearance: float, setting: float, solver: str) -> Answer:
    """One run. Adaptive solvers: `setting` is the tolerance; the others: steps per saving
    interval."""
    exu = load_exudyn()
    _, mbs, place, force = _exudyn_system(clearance)
    settings = exu.SimulationSettings()
    stepping, adaptive = settings.timeIntegration, solver == "DOPRI5"
    stepping.endTime, stepping.verboseMode = question.duration, 0
    longest = LONGEST_EXUDYN if adaptive else question.interval / setting
    stepping.numberOfSteps = round(question.duration / longest)
    stepping.explicit.computeEndOfStepAccelerations = False
    # Where a contact closes, steps are halved down to the smallest: that is how this program finds
    # the touch.
    stepping.adaptiveStep, stepping.discontinuous.useRecommendedStepSize = adaptive, adaptive
    stepping.minimumStepSize, stepping.automaticStepSize = SMALLEST_STEP, adaptive
    if adaptive:
        stepping.relativeTolerance, stepping.absoluteTolerance = setting, rig.ATOL_SHARE * setting
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = RECORD
    mbs.SolveDynamic(
        settings,
        solverType=getattr(exu.DynamicSolverType, solver),
        showHints=False,
        updateInitialValues=False,
    )
    places, forces = mbs.GetSensorStoredData(place), mbs.GetSensorStoredData(force)
    times, first = np.unique(places[:, 0], return_index=True)
    at_grid = CubicSpline(times, places[first, 1])(question.times)
    steps = mbs.sys["dynamicSolver"].it.currentStepIndex
    return Answer(at_grid, float(np.linalg.norm(forces[:, 1:], axis=1).max()), steps)


def _exudyn_sample(task) -> tuple[float, float, float]:
    began = time.process_time()
    found = exudyn_run(*task)
    return found.peak, float(found.places[-1]), time.process_time() - began


@cache
def _processes() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("spawn"))


def exudyn_programs(question: rig.Question) -> list[rig.Program]:
    """Its adaptive solver, which finds touches, and the cheapest of those with fixed steps."""

    def batch(solver):
        def go(setting, clearances):
            return np.array(
                list(
                    _processes().map(
                        _exudyn_sample, [(question, float(c), setting, solver) for c in clearances]
                    )
                )
            )

        return rig.Batch(go, f"{os.cpu_count()} processes", most=8)

    law, coarse = "captured, friction from 0", rig.steps_ladder(1e-6, 1e-8)
    return [
        rig.Program(
            f"Exudyn {s}",
            law,
            ladder,
            lambda x, s=s: exudyn_run(question, rig.CLEARANCE, x, s),
            batch(s),
            a,
        )
        for s, ladder, a in (
            ("DOPRI5", rig.tolerance_ladder(1e-5, 1e-12), True),
            ("ExplicitMidpoint", coarse, False),
        )
    ]
