"""Mistakes that a newcomer makes, written by hand: with a mechanism before the eyes, not an
argument."""

import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxclear as jc
from jaxclear_command.cli import main
from tests.bad_input.functions import clearance, draft, problem, rig, run
from tests.bad_input.generated import Case

B = jc.Body(1.0, 1e-2)
PIN = jc.joint.Revolute()
HERTZ = jc.contact.Hertz()
Bearing = jc.clearance.PlanarJournalBearing
Step = jc.integrator.FixedStep


def arm(joint: Any = PIN, **changes: Any) -> jc.Mechanism:
    """One body on one joint."""
    given = {"bodies": {"arm": B}, "connections": {"pin": jc.Connection(joint, "ground", "arm")}}
    return jc.Mechanism(**(given | changes))


def joined(parent: Any, child: Any, **changes: Any) -> jc.Mechanism:
    return arm(connections={"pin": jc.Connection(PIN, parent, child, **changes)})


def short(mechanism: jc.Mechanism, **changes: Any) -> Any:
    return jc.simulate(mechanism, **({"duration": 1e-4, "save": 2} | changes))


# (what the answer must name, what was typed)
MISTAKES: list[tuple[str, Callable[[], Any]]] = [
    # bodies, names, places
    ("inertia", lambda: jc.Body(1.0)),
    ("mass", lambda: jc.Body(-1.0, 1.0)),
    ("mass", lambda: jc.Body("1 kg", 1.0)),
    ("inertia", lambda: jc.Body(1.0, 0.0)),
    ("inertia", lambda: jc.Body(1.0, (1.0, 1.0, 5.0))),
    ("inertia", lambda: jc.Body(1.0, ((1, 0, 0), (0, 1, 0), (0, 0, 1)))),
    ("com", lambda: jc.Body(1.0, 1.0, com=0.1)),
    ("com", lambda: jc.Body(1.0, 1.0, (0.1,))),
    ("center", lambda: jc.Body(1.0, 1.0, center=(0.1, 0.0))),
    ("ground", lambda: arm(bodies={"ground": B})),
    ("arn", lambda: joined("ground", "arn")),
    ("Ground", lambda: joined("Ground", "arm")),
    ("arm", lambda: joined("arm", "arm")),
    ("parent", lambda: joined(B, "arm")),
    ("child", lambda: joined("ground", B)),
    ("at", lambda: joined("ground", "arm", at=0.1)),
    ("axis", lambda: joined("ground", "arm", axis="w")),
    ("axis", lambda: joined("ground", "arm", axis=(0, 0, 0))),
    ("place", lambda: joined("ground", "arm", place=(0, 0))),
    ("bodies", lambda: arm(bodies=[B])),
    ("body", lambda: arm(bodies={"arm": 1.0})),
    ("link", lambda: arm(bodies={"arm": B, "link": B})),
    ("body", lambda: jc.Mechanism({}, {})),
    ("connections", lambda: jc.Mechanism({"arm": B})),
    ("connections", lambda: arm(connections=[PIN])),
    ("pin", lambda: arm(connections={"pin": PIN})),
    ("load", lambda: arm(loads=[jc.load.Gravity()])),
    ("g", lambda: arm(loads={"g": 9.81})),
    ("Gravity", lambda: arm(loads={"g": jc.load.Gravity(), "h": jc.load.Gravity()})),
    ("acceleration", lambda: jc.load.Gravity(-9.81)),
    ("start", lambda: arm(start=1.0)),
    ("pinn", lambda: arm(start={"pinn": 1.0})),
    ("start", lambda: arm(start={"pin": (1.0, 2.0)}) and jc.assemble(arm(start={"pin": (1, 2)}))),
    ("speeds", lambda: arm(speeds={"pin": "fast"})),
    ("initial", lambda: arm(initial={"pin": 1.0})),
    ("stabilisation", lambda: arm(stabilisation="baumgarte")),
    ("alpha", lambda: jc.Baumgarte(-1.0)),
    # joints and laws
    ("joint", lambda: arm("revolute")),
    ("joint", lambda: arm(jc.joint.Revolute)),
    ("Revolut", lambda: jc.joint.Revolut()),
    ("axis", lambda: jc.joint.Revolute(axis="x")),
    ("drive", lambda: jc.joint.Revolute(10.0)),
    ("drive", lambda: jc.joint.Revolute(drive=lambda t: t)),
    ("drive", lambda: jc.joint.Spherical(drive=jc.drive.ConstantSpeed(1.0))),
    ("contact", lambda: Bearing()),
    ("contact", lambda: Bearing("Hertz")),
    ("contact", lambda: Bearing(jc.contact.Hertz)),
    ("contact", lambda: Bearing(1e9)),
    ("friction", lambda: Bearing(HERTZ, 0.1)),
    ("friction", lambda: Bearing(HERTZ, jc.friction.Coulomb)),
    ("friction", lambda: Bearing(HERTZ, jc.wear.Archard())),
    ("wear", lambda: Bearing(HERTZ, wear=jc.wear.Archard())),
    ("bearing_wear", lambda: Bearing(HERTZ, bearing_wear=jc.wear.Archard())),
    ("clearance", lambda: Bearing(HERTZ, clearance=0.0)),
    ("clearance", lambda: Bearing(HERTZ, clearance="0.1 mm")),
    ("bearing_radius", lambda: Bearing(HERTZ, bearing_radius=1e-5)),
    ("radius", lambda: Bearing(HERTZ, radius=1e-2)),
    ("flange", lambda: jc.clearance.JournalBearing(HERTZ, flange=True)),
    (
        "flange",
        lambda: jc.clearance.JournalBearing(HERTZ, flange=jc.clearance.Flange(HERTZ, radius=5e-3)),
    ),
    ("journal", lambda: jc.clearance.JournalBearing(HERTZ, journal_length=1e-3)),
    ("stiffness", lambda: jc.contact.Hertz(1e9)),
    ("stiffness", lambda: jc.contact.Hertz(stiffness=-1e9)),
    ("exponent", lambda: jc.contact.Hertz(exponent=0.5)),
    ("contact.elastic", lambda: jc.contact.ContactForce(jc.contact.Linear(stiffness=1e6))),
    ("restitution", lambda: jc.contact.Flores(restitution=1.5)),
    ("restitution", lambda: jc.contact.Flores(restitution=0.0)),
    ("damping", lambda: jc.contact.Hertz(damping=3.0)),
    ("HuntCrosley", lambda: jc.contact.HuntCrosley()),
    ("young_modulus", lambda: jc.Material("steel", 0.3)),
    ("poisson_ratio", lambda: jc.Material(2e11, 0.6)),
    ("nu", lambda: jc.Material(young_modulus=2e11, nu=0.3)),
    ("stiffness", lambda: jc.stiffness.HertzStiffness("steel", "steel")),
    ("mu_static", lambda: jc.friction.LuGre(mu_static=0.1, mu_kinetic=0.2)),
    ("mu_static", lambda: jc.friction.ThreeZone(mu_kinetic=0.5)),
    ("static_speed", lambda: jc.friction.ThreeZone(static_speed=0.1, kinetic_speed=0.01)),
    ("inner_speed", lambda: jc.friction.Ambrosio(inner_speed=1e-2)),
    ("mu", lambda: jc.friction.Coulomb(mu=0.1)),
    ("Coulomb", lambda: jc.friction.Coulomb(0.1)),
    ("hardness", lambda: jc.wear.Archard(hardness=0.0)),
    ("cells", lambda: jc.Wearing(jc.wear.Archard(), cells=72)),
    ("cells", lambda: jc.Wearing(jc.wear.Archard(), cells=(2, 2))),
    # loads and drives
    ("marker", lambda: jc.load.Force("arm", (1.0, 0.0))),
    ("value", lambda: jc.load.Force(jc.Marker("arm"), 10.0)),
    ("value", lambda: jc.load.Torque(jc.Marker("arm"), (1.0, 2.0))),
    ("arn", lambda: arm(loads={"f": jc.load.Force(jc.Marker("arn"), (1.0, 0.0))})),
    ("pim", lambda: arm(loads={"t": jc.load.JointTorque("pim", 1.0)})),
    ("stiffness", lambda: jc.load.Spring(jc.Marker("arm"), jc.Marker("ground"), -10.0)),
    ("stiffness", lambda: jc.load.Spring(jc.Marker("arm"), jc.Marker("ground"))),
    ("damping", lambda: jc.load.JointSpring("pin", 1.0, damping=-1.0)),
    ("function", lambda: jc.drive.Position(3.0)),
    ("function", lambda: jc.drive.Position(lambda: 3.0)),
    ("function", lambda: jc.drive.Position(lambda t: (t, t))),
    ("function", lambda: jc.drive.Speed(lambda t: "fast")),
    ("value", lambda: jc.load.Force(jc.Marker("arm"), lambda t: t)),
    ("value", lambda: jc.load.JointTorque("pin", lambda: 1.0)),
    ("speed", lambda: jc.drive.ConstantSpeed()),
    ("frequency", lambda: jc.drive.Harmonic(1.0, -2.0)),
    # integrators
    ("solver", lambda: jc.integrator.Adaptive("RK45")),
    ("rtol", lambda: jc.integrator.Adaptive(rtol=10.0)),
    ("atol", lambda: jc.integrator.Adaptive(atol=0.0)),
    ("largest_step", lambda: jc.integrator.Adaptive(largest_step=-1e-3)),
    ("method", lambda: Step(method="rk5")),
    ("rk4", lambda: Step(1e-4, "RK-4")),
    ("step", lambda: Step(0.0)),
    ("step", lambda: Step("small")),
    ("dt", lambda: Step(dt=1e-4)),
    ("steps_per_save", lambda: Step(steps_per_save=1.5)),
    ("contact_steps", lambda: Step(contact_steps=0.5)),
    ("newton", lambda: jc.integrator.ImplicitStep(newton_iterations=0)),
    ("gamma", lambda: jc.integrator.MoreauJean(gamma=-1.0)),
    ("tolerance", lambda: jc.integrator.MoreauJean(tolerance=0.0)),
    ("max_sweeps", lambda: jc.integrator.NonColliding(max_sweeps=0)),
    # runs, studies
    ("integrator", lambda: short(rig(), integrator="rk4")),
    ("integrator", lambda: short(rig(), integrator=jc.integrator.Adaptive)),
    ("duration", lambda: short(rig(), duration=-1.0)),
    ("step", lambda: short(rig(), step=1e-4)),
    ("save", lambda: short(rig(), save=True)),
    ("simulated", lambda: short({"bodies": {}})),
    ("b", lambda: run().contact("b")),
    ('"O"', lambda: run().contact("O")),
    ("Rod", lambda: run().body("Rod")),
    ("body", lambda: run().body(B)),
    ("balance", lambda: run().energy_balance()),
    ("wear", lambda: run().worn_depth("B", "bearing")),
    ("response", lambda: draft(response=jc.response.PeakWornDepth)),
    ("response", lambda: draft(response={})),
    ("response", lambda: draft(response="force")),
    ("joint", lambda: jc.response.MeanContactForce(PIN)),
    ("reference", lambda: jc.response.PositionError("rod", (0.0, 0.0))),
    (
        "clearence",
        lambda: draft(variables={"c": varied(lambda r: r.connections["B"].joint.clearence)}),
    ),
    ("Bb", lambda: draft(variables={"c": varied(lambda r: r.connections["Bb"].joint.clearance)})),
    ("variable", lambda: draft(variables={"c": varied(lambda r: r.connections["B"])})),
    ("variable", lambda: draft(variables={"c": clearance})),
    ("tolerance", lambda: jc.Variable(clearance, tolerance=0.0)),
    ("distribution", lambda: jc.Variable(clearance)),
    ("distribution", lambda: jc.Variable(clearance, "normal")),
    ("standard_deviation", lambda: jc.distribution.Normal(0.0)),
    ("bound", lambda: jc.distribution.TruncatedNormal(1.0, bound=-1.0)),
    ("copies", lambda: jc.PilotSettings(copies=0)),
    ("mass", lambda: jc.Body(np.array("1"), 1.0)),
    ("read-only", lambda: setattr(jc.Body(1.0, 1e-2), "mass", 2.0)),
    ("couplings", lambda: arm(couplings=[jc.coupling.Gear("a", "b", 2.0)])),
    ("g", lambda: arm(couplings={"g": jc.coupling.Gear("arm", "ground", 2.0)})),
    ("push", lambda: arm(loads={"push": jc.load.Force(jc.Marker("ground"), (1.0, 0.0))})),
    ("push", lambda: short(arm(loads={"push": jc.load.JointTorque("pin", lambda t: 1 / t)}))),
    ("pin", lambda: short(arm(jc.joint.Revolute(drive=jc.drive.Position(jax.numpy.sqrt))))),
    ("half_width", lambda: jc.distribution.Uniform(-1e-3, 1e-3)),
    ("force", lambda: draft(response={"force": lambda r: float(r.ended)})),
    ("force", lambda: draft(response={"force": jc.response.MeanContactForce("b")})),
    ("force", lambda: draft(response={"force": lambda r: r.body("rodd").com[-1, 0]})),
    ("force", lambda: draft(response={"force": lambda r: r.contact("B").normal_force})),
    ("x", lambda: draft(correlation={("clearance", "x"): 0.5})),
    ("variable", lambda: draft(variables={"c": varied(lambda r: 2 * clearance(r))})),
    ("planar", lambda: jc.scenes.four_bar("plannar")),
    ("four_bar", lambda: jc.scenes.fourbar()),
    ("clearance", lambda: jc.scenes.slider_crank("planar", 0.0)),
]
# These compile a run first.
SLOW: list[tuple[str, Callable[[], Any]]] = [
    ("response", lambda: sampled(lambda r: r.contact("B").normal_force)),
    ("response", lambda: sampled(lambda r: None)),
    ("response", lambda: sampled(lambda r: "high")),
    ("b", lambda: sampled(jc.response.MeanContactForce("b"))),
    ("index", lambda: sampled(jc.response.FinalCoordinate("G", 7))),
    ("surface", lambda: sampled(jc.response.PeakWornDepth("B"))),
    ("samples", lambda: jc.monte_carlo(problem(), 0)),
    ("sobol", lambda: jc.monte_carlo(problem(), 4, sampling="sobl")),
    ("variable", lambda: jc.sensitivity(problem(), "clearence")),
    ("method", lambda: jc.sensitivity(problem(), methods=("adjoint",))),
    ("method", lambda: jc.sensitivity(problem(), methods="regression")),
    ("accuracy", lambda: jc.advise(problem(), 5)),
]
COMMANDS = {
    "four-barr": ["four-barr"],
    "samples": ["four-bar", "--samples", "-1"],
    "sampels": ["four-bar", "--sampels", "20"],
    "out": ["guide", "--out", str(Path(__file__))],
    "duration": ["antenna", "--duration", "inf"],
    "clearance": ["guide", "--clearance", "-1e-5"],
    "turns": ["four-bar", "--turns", "0"],
    "command": [],
}


def varied(where: Callable) -> jc.Variable:
    return jc.Variable(where, tolerance=1e-5)


def sampled(response: Any) -> Any:
    return jc.monte_carlo(draft(response=response, integrator=Step(2e-5)), 2)


def cases() -> Iterator[Case]:
    """Every mistake that compiles nothing."""
    for place, (name, call) in enumerate(MISTAKES):
        yield Case("by hand", f"{place}: {name}", call, (name,))
    for name, given in COMMANDS.items():
        yield Case("command line", name, functools.partial(main, given), (name,))


def compiled_cases() -> Iterator[Case]:
    """Those that compile a run."""
    for place, (name, call) in enumerate(SLOW):
        yield Case("by hand", f"{place}: {name}", call, (name,))
