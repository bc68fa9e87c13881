"""A slider-crank with a rod that bends in Exudyn: reference of
`tests/oracles/test_exudyn_flexible_rod.py`.

The rod is a row of cables by absolute nodal coordinates (`ANCFCable2D`), the pin of the crank runs
in a circle, the slider is a mass on a line. `--json FILE` writes how far the slider is from where a
rigid rod without play would have it, and how far the middle of the rod from its chord: over one
turn with ideal joints, over a part of it where the pin of the slider is loose and meets its bearing
by a linear spring.
"""

import itertools
import json
import math
import re
from importlib.metadata import version

import numpy as np

from benchmarks.measure import arguments

CRANK, ROD, DIAMETER = 0.05, 0.12, 6e-3
MODULUS, DENSITY, DAMPING = 200e9, 7850.0, 0.02
SPEED, SLIDER = 150.0, 0.14
AREA, SECOND = math.pi * DIAMETER**2 / 4, math.pi * DIAMETER**4 / 64
# Stiffness-proportional damping, by its ratio in the first mode of bending on pins [s].
DELAY = 2 * DAMPING / ((math.pi / ROD) ** 2 * math.sqrt(MODULUS * SECOND / (DENSITY * AREA)))
DURATION, INSTANTS = 2 * math.pi / SPEED, 25
ELEMENTS, STEPS, SPECTRAL_RADIUS, NEWTON = 8, 9600, 0.9, 1e-10
# The loose pin: radial clearance [m], stiffness of the contact [N/m], share of a turn.
CLEARANCE, STIFFNESS, SHARE = 0.1e-3, 1e7, 0.15
# Of the tests [m].
TOLERANCE, LOOSE_TOLERANCE = 2e-7, 3e-6


def _rod(items, mbs) -> list:
    """The nodes of the rod, along x from the pin of the crank; its speeds are a rigid rod's."""
    nodes = []
    for share in np.linspace(0, 1, ELEMENTS + 1):
        turning = -SPEED * CRANK / ROD
        node = items.NodePoint2DSlope1(
            referenceCoordinates=[CRANK + ROD * share, 0, 1, 0],
            initialVelocities=[0, SPEED * CRANK * (1 - share), 0, turning],
        )
        nodes.append(mbs.AddNode(node))
    for ends in itertools.pairwise(nodes):
        cable = items.ObjectANCFCable2D(
            nodeNumbers=list(ends),
            length=ROD / ELEMENTS,
            massPerLength=DENSITY * AREA,
            bendingStiffness=MODULUS * SECOND,
            axialStiffness=MODULUS * AREA,
            bendingDamping=DELAY * MODULUS * SECOND,
            axialDamping=DELAY * MODULUS * AREA,
            useReducedOrderIntegration=0,
        )
        mbs.AddObject(cable)
    return nodes


def contact(mbs, t, item, offset, velocity, *_):
    """Force of the loose pin [N] at an offset [m] between the centres of pin and bearing."""
    distance = math.hypot(offset[0], offset[1])
    pull = STIFFNESS * max(distance - CLEARANCE, 0.0) / max(distance, 1e-12)
    return [pull * offset[0], pull * offset[1], 0.0]


def _joints(items, mbs, nodes: list, loose: bool) -> int:
    """The pin of the crank on its circle, and the slider on its line, whose node it returns."""
    ground = mbs.AddNode(items.NodePointGround())
    slider = mbs.AddNode(items.NodePoint2D(referenceCoordinates=[CRANK + ROD, 0]))
    mbs.AddObject(items.ObjectMassPoint2D(mass=SLIDER, nodeNumber=slider))

    def at(node, coordinate):
        return mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=node, coordinate=coordinate))

    def tie(first, second, **motion):
        tied = items.ObjectConnectorCoordinate(markerNumbers=[first, second], **motion)
        mbs.AddObject(tied)

    still = at(ground, 0)
    tie(
        still,
        at(nodes[0], 0),
        offsetUserFunction=lambda mbs, t, item, offset: CRANK * (math.cos(SPEED * t) - 1),
        offsetUserFunction_t=lambda mbs, t, item, offset: -CRANK * SPEED * math.sin(SPEED * t),
    )
    tie(
        still,
        at(nodes[0], 1),
        offsetUserFunction=lambda mbs, t, item, offset: CRANK * math.sin(SPEED * t),
        offsetUserFunction_t=lambda mbs, t, item, offset: CRANK * SPEED * math.cos(SPEED * t),
    )
    tie(still, at(slider, 1))
    if loose:
        ends = [mbs.AddMarker(items.MarkerNodePosition(nodeNumber=n)) for n in (nodes[-1], slider)]
        spring = items.ObjectConnectorCartesianSpringDamper(
            markerNumbers=ends, springForceUserFunction=contact
        )
        mbs.AddObject(spring)
    else:
        tie(still, at(nodes[-1], 1))
        tie(at(slider, 0), at(nodes[-1], 0))
    return slider


def turn(steps: int, loose: bool = False) -> dict[str, np.ndarray]:
    """One turn in so many steps, or a part of it with a loose pin: how far slider and middle of the
    rod are off [m]."""
    import exudyn as exu
    import exudyn.itemInterface as items

    mbs = exu.SystemContainer().AddSystem()
    nodes = _rod(items, mbs)
    slider = _joints(items, mbs, nodes, loose)
    duration = DURATION * (SHARE if loose else 1.0)
    kind = exu.OutputVariableType.Position
    sensors = [
        mbs.AddSensor(
            items.SensorNode(
                nodeNumber=node, outputVariableType=kind, storeInternal=True, writeToFile=False
            )
        )
        for node in (nodes[0], nodes[ELEMENTS // 2], nodes[-1], slider)
    ]
    mbs.Assemble()
    settings = exu.SimulationSettings()
    stepping = settings.timeIntegration
    stepping.endTime, stepping.numberOfSteps = duration, steps
    stepping.generalizedAlpha.spectralRadius = SPECTRAL_RADIUS
    stepping.newton.relativeTolerance = stepping.newton.absoluteTolerance = NEWTON
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = 0.5 * duration / steps
    mbs.SolveDynamic(settings, showHints=False)
    rows = [mbs.GetSensorStoredData(sensor) for sensor in sensors]
    times = np.linspace(0, duration, INSTANTS)
    pin, middle, end, mass = (
        np.stack([np.interp(times, own[:, 0], own[:, k]) for k in (1, 2)], axis=1) for own in rows
    )
    chord = (end - pin) / np.linalg.norm(end - pin, axis=1)[:, None]
    away = middle - pin
    angle = SPEED * times
    rigid = CRANK * np.cos(angle) + np.sqrt(ROD**2 - (CRANK * np.sin(angle)) ** 2)
    return {
        "slider": mass[:, 0] - rigid,
        "middle": chord[:, 0] * away[:, 1] - chord[:, 1] * away[:, 0],
    }


def main() -> None:
    options = arguments(__doc__)
    fine, apart = {}, []
    for label, loose in (("", False), ("loose ", True)):
        coarse, found = turn(STEPS // 2, loose), turn(STEPS, loose)
        apart.append(max(float(np.abs(coarse[name] - found[name]).max()) for name in found))
        print(f"{label}twice the step: off by {apart[-1]:.2g} m")
        fine |= {label + name: own for name, own in found.items()}
    if options.json is None:
        return
    document = {
        "source": "computed for this project by benchmarks/peers/exudyn_flexible_rod.py with "
        f"{ELEMENTS} elements ANCFCable2D, the pin of the crank led in a circle",
        "program": f"Exudyn {version('exudyn')}, generalised alpha (spectral radius "
        f"{SPECTRAL_RADIUS:g}), {STEPS} steps",
        "case": "a slider-crank with a flexible rod and ideal joints, one turn at constant speed: "
        "the slider beside that of a rigid rod, the middle of the rod beside its chord; and a "
        "part of it with a loose pin at the slider, pressed by a linear spring",
        "unit": {"time": "s"} | dict.fromkeys(fine, "m"),
        "tolerance": TOLERANCE,
        "loose tolerance": LOOSE_TOLERANCE,
        "why": f"the same program with twice the step is {apart[0]:.1g} m away, with the loose pin "
        f"{apart[1]:.1g} m",
        "loose": {"clearance": CLEARANCE, "stiffness": STIFFNESS, "share of the turn": SHARE},
        "time": np.linspace(0, DURATION, INSTANTS).tolist(),
    } | {name: np.round(own, 10).tolist() for name, own in fine.items()}
    text = re.sub(
        r"\[[^][]*\]", lambda own: " ".join(own[0].split()), json.dumps(document, indent=1)
    )
    options.json.write_text(text.replace("[ ", "[").replace(" ]", "]") + "\n")


if __name__ == "__main__":
    main()
