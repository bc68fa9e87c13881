"""An exported unit moves as `simulate` does: step by step, from parameters, from a saved state,
under inputs, and in a Python without JAX."""

import json
import subprocess
import sys

import equinox as eqx
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.fmu import link
from tests.rigs import fmi_host

STEP = jc.integrator.FixedStep(2e-5)
CLEARANCE = lambda rig: rig.connections["B"].joint.clearance
TORQUE = lambda rig: rig.loads["motor"].value
OUTPUTS = {
    "crank": ("O", "coordinate"),
    "slider": ("G", "coordinate"),
    "force at B": jc.response.MeanContactForce("B"),
    "pressed": lambda run: run.contact("B").normal_force[-1].sum(),
}


def rig(torque=0.3, clearance=0.2e-3):
    """A slider-crank whose crank is turned by a torque [N m]."""
    base = jc.scenes.slider_crank(clearance=clearance)
    crank = jc.Connection(jc.joint.Revolute(), "ground", "crank")
    rail = jc.Marker("ground", (0.0, 0.0), axis="x"), jc.Marker("slider", axis="x")
    joints = {"O": crank, "G": jc.Connection(jc.joint.Prismatic(), *rail)}
    loads = base.loads | {"motor": jc.load.JointTorque("O", torque)}
    guess = {"G": 0.17, "O": 0.0}
    return jc.Mechanism(
        base.bodies, base.connections | joints, loads, guess=guess, start={"O": 0.0}
    )


STEEL = 'connections["B"].joint.contact.elastic.stiffness.inner.young_modulus'
NUMBERS = {
    "clearance": CLEARANCE,
    "rod": 'bodies["rod"].mass',
    "rail": 'connections["G"].parent.at[1]',
    "steel": STEEL,
}


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    path = tmp_path_factory.mktemp("fmu") / "crank.fmu"
    asked = {"inputs": {"torque": TORQUE}, "outputs": OUTPUTS, "parameters": NUMBERS}
    return jc.export_fmu(rig(), path, integrator=STEP, **asked), fmi_host.Unit(path)


def run_of(mechanism, milliseconds):
    """Crank, slider, mean force over the last millisecond and force, at every millisecond."""
    end = 1e-3 * milliseconds
    run = jc.simulate(mechanism, end, save=milliseconds + 1, integrator=STEP, verify=False)
    force = np.diff(run.contact_impulse("B")) / np.diff(run.time)
    motion = [run.coordinate(name)[1:] for name in ("O", "G")]
    pressed = run.contact("B").normal_force[1:].sum(axis=1)
    return np.stack([*motion, force, pressed], axis=1)


def steps_of(instance, milliseconds):
    found = []
    for _ in range(milliseconds):
        assert instance.step(1e-3) == fmi_host.OK
        found.append(instance.get(*OUTPUTS))
    return np.array(found)


def test_steps_are_those_of_simulate(exported):
    """On the processor that the code is written for they are the same bits; by others products and
    sums are fused otherwise."""
    made, unit = exported
    assert made.size < 100_000
    found, expected = steps_of(fmi_host.Instance(unit), 40), run_of(rig(), 40)
    np.testing.assert_allclose(found[:15, :2], expected[:15, :2], rtol=0, atol=1e-13)
    # Later impacts have enlarged what rounding differs by where XLA prepares a run.
    np.testing.assert_allclose(found[:, :2], expected[:, :2], rtol=0, atol=1e-9)
    # A force is an indentation times 1e10 N/m.
    np.testing.assert_allclose(found[:, 2:], expected[:, 2:], rtol=1e-5, atol=1e-9)


def test_a_parameter_is_that_of_a_fresh_run(exported):
    """The start is assembled anew: with a wider gap the slider begins elsewhere."""
    _, unit = exported
    moved = eqx.tree_at(lambda m: (CLEARANCE(m), m.bodies["rod"].mass), rig(), (3e-4, 0.25))
    found = steps_of(fmi_host.Instance(unit, clearance=3e-4, rod=0.25), 5)
    np.testing.assert_allclose(found, run_of(moved, 5), rtol=1e-9, atol=1e-12)


def test_an_input_changes_between_steps(exported):
    """A torque that changes is a drive by hand: the run of a table of the same torque."""
    _, unit = exported
    instance = fmi_host.Instance(unit)
    found = []
    for k in range(6):
        assert instance.set("torque", 0.3 if k < 3 else -0.5) == fmi_host.OK
        assert instance.step(1e-3) == fmi_host.OK
        found.append(instance.get("crank")[0])
    early = jc.simulate(rig(0.3), 3e-3, save=4, integrator=STEP, verify=False)
    late = jc.simulate(rig(-0.5), 3e-3, save=4, integrator=STEP, verify=False, state=early.state())
    expected = [*early.coordinate("O")[1:], *late.coordinate("O")[1:]]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_a_saved_state_goes_on_in_another_instance(exported):
    _, unit = exported
    first = fmi_host.Instance(unit)
    steps_of(first, 20)
    raw = first.save()
    rest = steps_of(first, 10)
    second = fmi_host.Instance(unit)
    second.restore(raw, 0.02)
    assert np.array_equal(steps_of(second, 10), rest)
    assert second("Reset") == fmi_host.OK
    second.time = 0.0
    second.begin()
    assert np.array_equal(steps_of(second, 30)[20:], rest)


def test_it_runs_where_no_library_is_found(exported):
    """Neither JAX nor NumPy: Python without its site packages."""
    made, unit = exported
    command = [sys.executable, "-I", "-S", fmi_host.__file__, str(made.path), "3"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    told = json.loads(done.stdout)
    assert told["foreign"] == []
    assert np.array_equal(told["values"], steps_of(fmi_host.Instance(unit), 3)[-1])


def test_what_cannot_be_set_or_assembled_is_said(exported):
    _, unit = exported
    instance = fmi_host.Instance(unit, start=False)
    assert instance.set("clearance", -1.0) == fmi_host.ERROR
    assert "out of its range" in instance.messages[-1]
    instance.begin()
    assert instance.set("clearance", 3e-4) == fmi_host.ERROR
    assert "fixed once" in instance.messages[-1]
    instance.time = 0.5
    assert instance.step(1e-3) == fmi_host.ERROR
    assert "must begin where the last one ended" in instance.messages[-1]


def test_a_run_that_ends_early_says_why(exported):
    """Steps of 20 us under a torque of 1e9 N m: the mechanism flies apart; the unit stays where it
    was, and says what `simulate` does."""
    instance = fmi_host.Instance(exported[1])
    assert instance.step(1e-3) == fmi_host.OK
    before = instance.get("crank")
    instance.set("torque", 1e9)
    assert instance.step(1e-3) == fmi_host.DISCARD
    assert instance.early and instance.time == 1e-3
    assert instance.messages[-1].startswith("The run ended early, after 0.001 s. ")
    assert instance.get("crank") == before
    instance.set("torque", 0.3)
    assert instance.step(1e-3) == fmi_host.OK


def test_parameters_that_make_no_mechanism_and_contacts_beyond_their_law_are_said(exported):
    """A rail beyond the reach of crank and rod, 0.17 m; steel of 10 kPa lets the journal sink."""
    _, unit = exported
    instance = fmi_host.Instance(unit, start=False)
    with pytest.raises(AssertionError):
        instance.begin(rail=0.4)
    assert "cannot be assembled: its loops do not close" in instance.messages[-1]
    instance = fmi_host.Instance(unit, steel=1e4)
    assert instance.step(0.04) == fmi_host.OK
    assert instance("Terminate") == fmi_host.OK
    assert 'The indentation in joint "B" reaches' in instance.messages[-1]
    assert instance.step(1e-3) == fmi_host.ERROR


REFUSED = {
    "an input of FMI 3 has no rate": {
        "inputs": {"angle": 'connections["O"].joint.drive.start'},
        "mechanism": jc.scenes.slider_crank,
    },
    "must be a number of a load": {"inputs": {"gap": CLEARANCE}},
    "must be one number of the mechanism": {"parameters": {"gap": lambda rig: 2e-4}},
    r'output "crank" must be \(joint': {"outputs": {"crank": "O"}},
    "wear, which an FMU does not carry": {"mechanism": lambda: jc.scenes.slider_crank(wear=True)},
    'output "a" returns None': {"outputs": {"a": lambda run: None}},
    'name of "time" stands twice': {"outputs": {"time": ("O", "coordinate")}},
    'name of "torque" stands twice': {
        "inputs": {"torque": TORQUE},
        "parameters": {"torque": CLEARANCE},
    },
    'number of "gap" stands twice': {"parameters": {"play": CLEARANCE, "gap": CLEARANCE}},
    "a name in outputs of export_fmu is 3": {"outputs": {3: ("O", "coordinate")}},
    'target "amiga"': {"target": "amiga"},
    'cpu "z80"': {"cpu": "z80"},
    'kind "exchange"': {"kinds": "exchange"},
    'slope "gap"': {"parameters": {"play": CLEARANCE}, "slopes": "gap"},
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_cannot_be_a_unit_is_refused(sentence, tmp_path):
    asked = dict(REFUSED[sentence])
    mechanism = asked.pop("mechanism", rig)()
    with pytest.raises(ValueError, match=sentence):
        jc.export_fmu(mechanism, tmp_path / "no.fmu", integrator=STEP, **asked)


@pytest.mark.parametrize("path", ["crank", "crank.zip", "nowhere/crank.fmu"])
def test_a_path_that_no_host_reads_is_refused(path, tmp_path):
    with pytest.raises(ValueError, match=r'must end in "\.fmu", in a folder that there is'):
        jc.export_fmu(rig(), tmp_path / path, integrator=STEP)


def test_a_machine_without_a_compiler_is_told_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setattr(link.shutil, "which", lambda name: None)
    monkeypatch.setattr(link.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"jaxclear\[fmu\]"):
        link.find_compiler(link.this_machine())


def test_fmpy_finds_nothing_wrong(exported):
    validation = pytest.importorskip("fmpy.validation")
    made, _ = exported
    assert validation.validate_fmu(str(made.path)) == []
