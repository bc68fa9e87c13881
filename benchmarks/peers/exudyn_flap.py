"""The flap with one joint of clearance in Exudyn: reference of `tests/oracles/test_exudyn_flap.py`.

Rigid bodies in the plane, revolute joints, and in the joint with clearance a spring whose user
function is the contact law, written out here once more: Adams' IMPACT with Hertz's stiffness of the
paper's steel. The force acts at the centres, so there is no friction. Angles are looked at up to 20
ms, which is before any second impact; `--json FILE` writes them with where they come from.
"""

import json
import math
import re
from argparse import Namespace
from importlib.metadata import version

import numpy as np

from benchmarks.measure import arguments, report

# Bars of steel and of the light alloy [kg/m]; lengths [m]; inertia of the shaft [kg m2].
STEEL, ALLOY = 7890 * 20e-3 * 10e-3, 2700 * 20e-3 * 10e-3
ROD, SECOND, ARM, SHAFT_INERTIA = 0.15, 0.2, 0.06, 0.13
STROKE, FREQUENCY = 10e-3, 4.0
RADIUS, CLEARANCE, DAMPED = 7.5e-3, 0.1e-3, 0.01e-3
MODULUS = 209e9 / (2 * (1 - 0.269**2))
STIFFNESS = 4 / 3 * MODULUS * math.sqrt((RADIUS - CLEARANCE) * RADIUS / CLEARANCE)
# One percent of the stiffness as numbers in N and mm.
DAMPING = 0.01 * STIFFNESS / 1e3**1.5 * 1e3
JOINTS = ("J1", "J2", "J3", "J4")
BODIES = ("shaft", "lever 1", "rod 1", "rod 2")
TIMES = np.round(np.arange(4e-3, 20.1e-3, 2e-3), 6)
STEP, SPECTRAL_RADIUS = 2.5e-7, 0.6
# Relative and absolute tolerance of Newton's method: what rounding leaves is below.
NEWTON = 1e-8, 1e-7
# Of the test [rad]; digits behind the point that are kept.
TOLERANCE, DIGITS = 1e-9, 12


def impact_force(overlap: float, rate: float) -> float:
    """Adams' IMPACT [N] of an overlap [m] that grows at a rate [m/s]."""
    if overlap <= 0:
        return 0.0
    part = min(overlap / DAMPED, 1.0)
    return max(STIFFNESS * overlap**1.5 + DAMPING * part * part * (3 - 2 * part) * rate, 0.0)


def contact(mbs, t, item, offset, velocity, *_):
    """Force of the spring [N], which pulls the second marker towards the first, at an offset [m]
    between the joint's centres."""
    distance = math.hypot(offset[0], offset[1])
    if distance <= CLEARANCE:
        return [0.0, 0.0, 0.0]
    x, y = offset[0] / distance, offset[1] / distance
    force = impact_force(distance - CLEARANCE, velocity[0] * x + velocity[1] * y)
    return [force * x, force * y, 0.0]


def driven(mbs, t, item, offset):
    """Where the actuator is [m]."""
    return 0.5 * STROKE * (1 - math.cos(2 * math.pi * FREQUENCY * t))


def driven_speed(mbs, t, item, offset):
    """How fast it is there [m/s]."""
    turn = 2 * math.pi * FREQUENCY
    return 0.5 * STROKE * turn * math.sin(turn * t)


def _bodies(items, mbs) -> tuple[dict, dict]:
    """(node, object) of every body by its name. The shaft turns about its own centre of mass, which
    is its pivot."""
    bars = {
        "rod 1": (STEEL * ROD, STEEL * ROD**3 / 12, (0.5 * ROD, 0.0)),
        "lever 1": (ALLOY * ARM, ALLOY * ARM**3 / 12, (ROD, -0.5 * ARM)),
        "rod 2": (ALLOY * SECOND, ALLOY * SECOND**3 / 12, (ROD + 0.5 * SECOND, 0.0)),
        "shaft": (ALLOY * ARM, SHAFT_INERTIA, (ROD + SECOND, -ARM)),
        "actuator": (1.0, 1e-3, (0.0, 0.0)),
    }
    nodes, objects = {}, {}
    for name, (mass, inertia, place) in bars.items():
        nodes[name] = mbs.AddNode(items.NodeRigidBody2D(referenceCoordinates=[*place, 0.0]))
        objects[name] = mbs.AddObject(
            items.ObjectRigidBody2D(mass=mass, inertia=inertia, nodeNumber=nodes[name])
        )
    return nodes, objects


def _drive(items, mbs, node: int, ground: int) -> None:
    """The actuator, which moves along x and does not turn."""
    still = mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=ground, coordinate=0))
    for coordinate in range(3):
        own = mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=node, coordinate=coordinate))
        moves = coordinate == 0
        mbs.AddObject(
            items.ObjectConnectorCoordinate(
                markerNumbers=[still, own],
                offsetUserFunction=driven if moves else 0,
                offsetUserFunction_t=driven_speed if moves else 0,
            )
        )


def system(slack: str):
    """(Exudyn, the system, node by body) with one joint of clearance."""
    import exudyn as exu
    import exudyn.itemInterface as items

    mbs = exu.SystemContainer().AddSystem()
    nodes, objects = _bodies(items, mbs)
    base = mbs.AddObject(items.ObjectGround())
    still = mbs.AddNode(items.NodePointGround())
    _drive(items, mbs, nodes["actuator"], still)

    def at(name, place):
        there = [*place, 0.0]
        body = base if name is None else objects[name]
        return mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=body, localPosition=there))

    pivots = {
        "O1": (at(None, (ROD, -ARM)), at("lever 1", (0.0, -0.5 * ARM))),
        "O2": (at(None, (ROD + SECOND, -ARM)), at("shaft", (0.0, 0.0))),
    }
    ends = {
        "J1": (at("actuator", (0.0, 0.0)), at("rod 1", (-0.5 * ROD, 0.0))),
        "J2": (at("rod 1", (0.5 * ROD, 0.0)), at("lever 1", (0.0, 0.5 * ARM))),
        "J3": (at("lever 1", (0.0, 0.5 * ARM)), at("rod 2", (-0.5 * SECOND, 0.0))),
        "J4": (at("rod 2", (0.5 * SECOND, 0.0)), at("shaft", (0.0, ARM))),
    }
    for name, markers in (pivots | ends).items():
        if name == slack:
            spring = items.ObjectConnectorCartesianSpringDamper(
                markerNumbers=list(markers), springForceUserFunction=contact
            )
        else:
            spring = items.ObjectJointRevolute2D(markerNumbers=list(markers))
        mbs.AddObject(spring)
    return exu, mbs, nodes


def angles(slack: str, step: float) -> dict[str, np.ndarray]:
    """Angle of every body about z [rad] at the times."""
    exu, mbs, nodes = system(slack)
    from exudyn.itemInterface import SensorNode

    kept = {"storeInternal": True, "writeToFile": False}
    kind = exu.OutputVariableType.Coordinates
    sensors = {
        body: mbs.AddSensor(SensorNode(nodeNumber=nodes[body], outputVariableType=kind, **kept))
        for body in BODIES
    }
    mbs.Assemble()
    settings = exu.SimulationSettings()
    stepping = settings.timeIntegration
    stepping.endTime, stepping.numberOfSteps = TIMES[-1], round(TIMES[-1] / step)
    stepping.adaptiveStep = False
    stepping.generalizedAlpha.spectralRadius = SPECTRAL_RADIUS
    stepping.newton.relativeTolerance, stepping.newton.absoluteTolerance = NEWTON
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = 0.5 * (TIMES[1] - TIMES[0])
    mbs.SolveDynamic(settings, showHints=False)
    found = {}
    for body, sensor in sensors.items():
        rows = mbs.GetSensorStoredData(sensor)
        at = [int(np.argmin(abs(rows[:, 0] - time))) for time in TIMES]
        assert np.allclose(rows[at, 0], TIMES, rtol=0, atol=1e-9), "a time was not recorded"
        found[body] = rows[at, 3]
    return found


def document(found: dict[str, dict[str, np.ndarray]], apart: float) -> dict:
    """The file of the reference; `apart`: how far twice the step is from it [rad]."""
    return {
        "source": "computed for this project by benchmarks/peers/exudyn_flap.py with Exudyn's "
        "rigid bodies in the plane, revolute joints and a CartesianSpringDamper whose user "
        "function is the contact law",
        "program": f"Exudyn {version('exudyn')}, generalised alpha (spectral radius "
        f"{SPECTRAL_RADIUS:g}), step {STEP:g} s",
        "case": f"the flap with one joint of clearance {1e3 * CLEARANCE:g} mm and without "
        "friction, from concentric rest: angles about z",
        "unit": {"time": "s", "angles": "rad"},
        "tolerance": TOLERANCE,
        "why": f"the same program with twice the step is {apart:.1g} rad away, with four times "
        f"the step four times as far; {TOLERANCE:g} rad of the lever's 60 mm arm are 6e-11 m",
        "time": TIMES.tolist(),
        "angles": {
            slack: {body: np.round(own, DIGITS).tolist() for body, own in of.items()}
            for slack, of in found.items()
        },
    }


def main() -> None:
    options = arguments(__doc__)
    found, rows = {}, []
    for slack in JOINTS:
        coarsest, coarse, fine = (angles(slack, STEP * factor) for factor in (4, 2, 1))
        far = lambda one, other: max(float(np.abs(one[b] - other[b]).max()) for b in BODIES)
        rows.append(
            {
                "joint": slack,
                "twice the step, off by [rad]": far(coarse, fine),
                "four times, off by twice [rad]": far(coarsest, coarse),
            }
        )
        found[slack] = fine
    report("angles of the flap in Exudyn", rows, Namespace(json=None))
    if options.json is not None:
        apart = max(row["twice the step, off by [rad]"] for row in rows)
        text = json.dumps(document(found, apart), indent=1)
        # A list of numbers on one line.
        rows = re.sub(r"\[[^][]*\]", lambda own: " ".join(own[0].split()), text)
        options.json.write_text(rows.replace("[ ", "[").replace(" ]", "]") + "\n")


if __name__ == "__main__":
    main()
