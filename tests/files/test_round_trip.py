"""What is written is read again as it was, leaf by leaf: every class of every family that a file
may name, and every ready mechanism. A new class is covered the moment it is defined.

The JSON schema of scene files says what reading says, as far as a schema can, and the published
one is current. `python -m tests.files.test_round_trip` writes it anew."""

import functools
import json
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import jsonschema
import numpy as np
import pytest

import jaxclear as jc
import jaxclear.studies.identification.laws  # classes of the package that load late
from jaxclear.files import forms
from jaxclear.files.parts import Part, arguments, final_classes
from jaxclear.files.scene import RUN, TOP, scene_text
from jaxclear.files.text import parse_values
from jaxclear.studies.position_problem import PositionExperiment
from jaxclear.studies.store.digest import difference, in_texts
from tests.rigs.refusals import refusals

TOGETHER = (
    {"low": -1.0, "high": 1.0, "mode": 0.25, "bound": 2.0, "poisson_ratio": 0.375}
    | {"deviations": [-1.0, 0.5], "shares": [0.25, 0.75], "coarseness": 2.0, "number": 3}
    | {"outer_radius": 0.5, "inner_radius": 0.25, "inner_diameter": 0.25, "outer_diameter": 0.5}
    | dict.fromkeys(("GJ", "turning_inertia", "EA", "bearing_radius", "socket_radius"), 0.5)
    | {"width": 0.5, "clearance": 0.01, "journal_length": 2.0, "length": 1.5, "radius": 0.75}
    | {"mu_static": 0.75, "mu_kinetic": 0.5, "static_speed": 0.25, "kinetic_speed": 0.75}
    | {"inner_speed": 0.25, "outer_speed": 0.75, "stribeck_speed": 1.5, "unit": "m"}
    | dict.fromkeys(("roundness", "film", "contact_steps", "quaternion"))
    | {"method": "heun", "solver": "Tsit5", "steps_per_save": 7, "cells": [12, 3], "axes": [0, 2]}
    | {name: [0.25, 0.5, 0.75] for name in ("com", "at", "axis")}
    | {"reference": [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]], "where": 'bodies["crank"].mass'}
    | {"inertia": [2.0, 2.5, 3.0, 0.1, 0.2, 0.3]}
)
# Of one class only.
ONE_TURN = {
    "kind": "TimeTable",
    "times": [0.0, 2.0, 4.0, 2 * np.pi],
    "values": [0.0, 1.0, 0.5, 0.0],
    "beyond": "repeated",
}
# A zone is on a marker, round or between planes.
ZONE = {"marker": "A.parent", "along": "x", "spherical": False, "width": None, "at_lmc": None}
# Surfaces of ideal joints have no worn radius.
ARCHARD_WEAR = {
    "kind": "Wearing",
    "law": {"kind": "Archard", "wear_coefficient": 1e-4, "hardness": 2e9},
}
HEATED = {"kind": "Heating", "expansion": {"crank": 1e-5, "rod": 2e-5}}
# By class and argument.
OF_CLASSES = {
    "PlainBearing": {"wear": ARCHARD_WEAR},
    "Slideway": {"wear": ARCHARD_WEAR},
    "BallJoint": {"wear": ARCHARD_WEAR},
    "KelvinVoigt": {"stiffness": "number"},
    "Belt": {"play": None},
    "Cam": {"profile": ONE_TURN},
    "Gear": {"transmission_error": ONE_TURN},
    "Rope": {"over": ["crank", "rod"]},
    "Servo": {"reference": 0.5, "encoder": "load"},
    "Motor": {"inertia": 0.5},
    "Position": {"function": {"kind": "PeriodicTorque", "amplitude": 0.5}},
    "Force": {"value": [1.0, 2.0, 3.0]},
    "Connection": {"axis": None, "at": None},
    "Variable": {"tolerance": None},
    "Condition": {"tolerance": None, "acts": HEATED},
    "Heating": {"expansion": HEATED["expansion"]},
    "JointStop": {"lower": -0.5, "upper": 0.5},
    "Empirical": {"deviations": [-1.0, 0.0, 2.0], "low": -3.0, "high": 3.0},
    "FromScipy": {"scipy": None, "numbers": None, "about": None, "spread": 0.5}
    | {"table": {"scores": [-1, 0, 1], "deviations": [-2, 0, 2], "slopes": [2, 2, 2]}},
    "ContactForce": {"memory": None}
    | {"dissipation": {"kind": "LankaraniNikravesh", "restitution": 0.75}},
    "Fit": {"fit": "20 H7/g6"},
    "Capability": {"cp": 1.5, "cpk": 1.0, "distribution": "normal"},
    "LargestError": {"body": None, "axis": 1, "reference": [0.0, 1.0]},
    "SliderGuide": {"guide_length": 4.0}
    | {name: {"law": {"kind": "Archard"}} for name in ("guide_wear", "slider_wear")},
    "State": {"motion": None},
    "TimeTable": {"csv": None, "columns": None, "interpolation": "monotone", "beyond": "straight"}
    | {"times": [0.0, 0.25, 0.5, 1.0], "values": [0.0, 1 / 3, 2.0, 0.0]},
    "Coaxiality": ZONE,
} | {zone: ZONE | {"width": 0.5} for zone in ("Angularity", "Parallelism", "Perpendicularity")}


def classes_of_package(families):
    """Classes that other test files define count as read by a file, too, but are no part of it."""
    return {
        name: kind
        for name, kind in final_classes(families).items()
        if kind.__module__.startswith("jaxclear.")
    }


def reachable():
    """Every class that a scene file may name, with a field form under which it stands."""
    left, found = [*TOP.values(), *RUN.values()], {}
    while left:
        form = left.pop()
        if isinstance(form, forms.Choice):
            left += form.forms
        elif isinstance(form, (forms.ByName, forms.Listed)):
            left.append(form.entry)
        elif isinstance(form, Part):
            for name, kind in classes_of_package(form.families).items():
                if name not in found:
                    found[name] = (kind, Part(form.families))
                    left += [own.form for own in arguments(kind).values() if own.form is not None]
    return found


REACHABLE = reachable()


def within(metadata):
    low = max(metadata.get("above", -np.inf), metadata.get("at_least", -np.inf))
    high = min(metadata.get("below", np.inf), metadata.get("at_most", np.inf))
    if np.isfinite(low) and np.isfinite(high):
        return 0.375 * low + 0.625 * high
    return low + 1.1 if np.isfinite(low) else min(high, 0.7)


SAMPLES = {
    forms.Number: lambda form, _: within(form.metadata),
    forms.Numbers: lambda form, _: [
        within(form.metadata) + 0.125 * k for k in range(max(form.counts, default=2))
    ],
    forms.NumberArray: lambda *_: [0.25, 1 / 3, 0.75],
    forms.Integer: lambda form, _: form.metadata.get("at_least", 1) + 1,
    forms.Flag: lambda *_: True,
    forms.Text: lambda *_: "crank",
    forms.Place: lambda *_: 'bodies["crank"].mass',
    forms.Listed: lambda form, depth: [sample(form.entry, depth)] * (form.length or 1),
    forms.ByName: lambda form, depth: {"crank": sample(form.entry, depth)},
    forms.Choice: lambda form, depth: sample(form.forms[depth % len(form.forms)], depth),
    Part: lambda form, depth: of_class(
        next(iter(classes_of_package(form.families).values())), depth + 1
    ),
}


def sample(form, depth):
    """Plain values of a form."""
    return next(make for kind, make in SAMPLES.items() if isinstance(form, kind))(form, depth)


def of_class(kind, depth=0):
    """Plain values of every argument of a class."""
    found = {"kind": kind.__name__}
    for name, own in arguments(kind).items():
        if name in OF_CLASSES.get(kind.__name__, {}):
            value = OF_CLASSES[kind.__name__][name]
            value = within(own.metadata) if value == "number" else value
        elif name in TOGETHER and own.form is not None:
            value = TOGETHER[name]
        elif own.form is None or (depth > 6 and not own.needed):
            continue
        else:
            value = sample(own.form, depth)
        if value is not None:
            found[name] = value
    return found


def as_node(values):
    return parse_values(json.dumps(values), ".json")


def assert_same(one, other):
    """Leaf by leaf, static fields too."""
    assert type(one) is type(other)
    if isinstance(one, jc.Saving):
        assert np.array_equal(one.at, other.at) and one.events == other.events
    elif isinstance(one, eqx.Module):
        assert eqx.tree_equal(one, other, typematch=True)
    else:
        assert one == other


MECHANISM = jc.scenes.slider_crank()


def test_every_family_has_members():
    """The walk over the forms of a scene finds what a file is for."""
    assert {"Body", "Marker", "Connection", "Mechanism", "Revolute", "JournalBearing"} <= {
        *REACHABLE
    }
    for family in (
        *(jc.joint.AbstractJoint, jc.clearance.AbstractClearance, jc.drive.AbstractDrive),
        *(jc.load.AbstractLoad, jc.contact.AbstractNormalLaw, jc.contact.AbstractElasticForce),
        *(jc.contact.AbstractDissipation, jc.friction.AbstractFrictionLaw),
        *(jc.wear.AbstractWearLaw, jc.stiffness.AbstractFit, jc.integrator.AbstractIntegrator),
        *(jc.distribution.AbstractDistribution, jc.response.AbstractResponse),
    ):
        own = {
            n for n, k in final_classes((family,)).items() if k.__module__.startswith("jaxclear")
        }
        assert own and own <= {*REACHABLE}, family


def test_a_users_class_hides_none_of_the_package_and_its_last_definition_counts():
    class Family(eqx.Module):
        pass

    def define():
        class Spring(Family):
            pass

        return Spring

    kinds = [define(), define()]
    assert final_classes((Family,))["Spring"] is kinds[1]
    assert final_classes((Family, jc.load.AbstractLoad))["Spring"] is jc.load.Spring


@pytest.mark.parametrize("kind", ["OverStep", "StopOfRatio", "MobileJournal"])
def test_what_the_package_uses_inside_stands_in_no_file(kind, tmp_path):
    """Loads as steps see them, of which users are offered none."""
    path = tmp_path / "scene.yaml"
    jc.write_scene(jc.Scene(MECHANISM, 1.0), path)
    text = path.read_text()
    assert kind not in json.dumps(jc.scene_schema())
    load = f"\n    inside: {{kind: {kind}, connection: A}}"
    place = text.index("loads:") + len("loads:")
    path.write_text(text[:place] + load + text[place:])
    with pytest.raises(ValueError, match=f'has no kind "{kind}"|{kind}.* that fits here'):
        jc.read_scene(path)


def test_every_argument_of_every_class_has_a_file_form():
    known = {
        "Variable": ["derived"],
        # A function is code.
        "FromFunction": ["function"],
    }
    lacking = {
        name: [n for n, own in arguments(kind).items() if own.form is None]
        for name, (kind, _) in REACHABLE.items()
    }
    assert {name: own for name, own in lacking.items() if own} == known


@pytest.mark.parametrize("name", sorted({*REACHABLE} - {"Mechanism", "FromFunction"}))
def test_every_class_is_read_as_it_was_written(name, tmp_path):
    kind, form = REACHABLE[name]
    built = form.read(as_node(of_class(kind)), "here", tmp_path)
    assert type(built) is kind
    written = form.plain(built, "here", MECHANISM)
    again = form.read(as_node(written), "here", tmp_path)
    assert_same(built, again)
    assert form.plain(again, "here", MECHANISM) == written


SCENES = {name: getattr(jc.scenes, name) for name in jc.scenes.__all__}
VISCOUS = jc.film.Reynolds(viscosity=jc.film.Vogel(6e-5, 1030.0, 153.6, 313.0))
BEAM = jc.Beam(0.12, jc.section.Circle(6e-3), jc.material.steel(), 7850.0, 4, space=False)
FURTHER = {
    "planar four-bar": lambda: jc.scenes.four_bar("planar"),
    "ideal four-bar": lambda: jc.scenes.four_bar("ideal"),
    "step-driven antenna": lambda: jc.scenes.antenna(drive="step"),
    # Its markers lie on the beam in the file, on pieces of it in the mechanism.
    "slider-crank with a beam": lambda: jc.scenes.slider_crank().with_body("rod", BEAM),
    "slider-crank on a film": lambda: jc.scenes.slider_crank(
        jc.clearance.PlanarJournalBearing(jc.contact.Hertz(), film=VISCOUS)
    ),
    "with numbers changed": lambda: eqx.tree_at(
        lambda m: m.bodies["rod"].mass, jc.scenes.slider_crank(), jnp.asarray(1 / 3)
    ),
}


@pytest.mark.parametrize("name", [*SCENES, *FURTHER])
def test_every_ready_mechanism_is_read_as_it_was_written(name, tmp_path):
    mechanism = (SCENES | FURTHER)[name]()
    for path in (tmp_path / "scene.yaml", tmp_path / "scene.json"):
        jc.write_scene(mechanism, path)
        again = jc.read_scene(path).mechanism
        assert eqx.tree_equal(mechanism, again, typematch=True)
        assert again.topology == mechanism.topology


CLEARANCE = {"clearance": jc.Variable(lambda m: m.connections["B"].joint.clearance, tolerance=1e-5)}


def asked():
    """A scene that states all that a scene may."""
    masses = lambda m: [m.bodies["rod"].mass, m.bodies["crank"].mass]
    return jc.Scene(
        jc.scenes.slider_crank(wear=True),
        0.01,
        jc.integrator.FixedStep(1e-5),
        jc.Saving(11, events=3),
        jc.State(concentric=False),
        variables=CLEARANCE | {"masses": jc.Variable(masses, jc.distribution.Uniform(1e-3))},
        responses={"force": jc.response.PeakContactForce("B")},
        correlation={("clearance", "masses"): 0.25},
        description="All that a scene may state.",
    )


def written_and_read(scene, path):
    """The scene that a file holds, which says the same."""
    jc.write_scene(scene, path)
    again = jc.read_scene(path)
    assert scene_text(again) == scene_text(scene)
    return again


def asked_over_positions():
    """A scene without time: where a four-bar stands, warmer or colder, with play in one joint."""
    rig, heating = jc.scenes.four_bar("planar"), jc.Heating({"coupler": 11.5e-6, "crank": 23e-6})
    return jc.Scene(
        rig,
        positions={rig.driven[0]: np.linspace(0.0, 1.0, 3)},
        reverse_loads=True,
        variables=CLEARANCE | {"warmth": jc.Condition(heating, 0.0, tolerance=40.0)},
        responses={"lost": jc.response.LostMotion("D")},
    )


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".yaml", ".json"])
def test_a_scene_over_positions_asks_the_same_after_it_was_written(ending, tmp_path):
    scene = asked_over_positions()
    again = written_and_read(scene, tmp_path / f"scene{ending}")
    one, other = scene.problem(), again.problem()
    assert isinstance(one.experiment, PositionExperiment)
    assert in_texts(other) == in_texts(one)
    stood = one.detail(one.nominal())
    np.testing.assert_array_equal(again.stand().body("coupler").com, stood.body("coupler").com)


RIG = jc.scenes.slider_crank()
test_a_scene_is_a_run_or_positions = refusals(
    {
        'positions and "duration"': lambda: jc.Scene(RIG, duration=1.0, positions={"O": [0.1]}),
        "reverse_loads without positions": lambda: jc.Scene(RIG, reverse_loads=True),
        'positions of joint "O" are .* numbers in a row': lambda: jc.Scene(
            RIG, positions={"O": [[0.1]]}
        ),
        "states positions, without time: ask scene.stand": lambda: jc.Scene(
            RIG, positions={"O": [0.1]}
        ).simulate(),
        "states no positions": lambda: jc.Scene(RIG, 1.0).stand(),
    }
)


def test_what_is_code_is_refused_by_its_place(tmp_path):
    where = lambda m: m.bodies["rod"].mass
    derived = [(lambda m: m.bodies["rod"].inertia, lambda m: m.bodies["rod"].inertia[0])]
    scene = lambda **asked: jc.Scene(RIG, 1.0, **asked)
    for sentence, given in {
        'variables."w".*.acts is the function <lambda>: .* data, no code. Take .*"Heat': scene(
            variables={"w": jc.Condition(lambda m, x: m, 0.0, tolerance=1.0)}
        ),
        'variables."m".*.derived is .* holds data, no code': scene(
            variables={"m": jc.Variable(where, tolerance=0.1, derived=derived)}
        ),
        'responses."x".* is the function <lambda>: a file holds data, no code': scene(
            responses={"x": lambda run: run.time[-1]}
        ),
        'loads."f".*.value is the function <lambda>.*jaxclear.TimeTable.sampled': RIG.with_loads(
            {"f": jc.load.JointTorque("A", lambda t: t)}
        ),
        "what is written is the class Problem; it must be a jaxclear.Scene": jc.Problem,
    }.items():
        with pytest.raises(ValueError, match=sentence):
            jc.write_scene(given, tmp_path / "scene.yaml")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending", [".yaml", ".json"])
def test_a_scene_asks_the_same_after_it_was_written(ending, tmp_path):
    """The problem that is read is the one that was written: a store of a study knows it again."""
    scene = asked()
    again = written_and_read(scene, tmp_path / f"scene{ending}").problem()
    assert in_texts(again) == in_texts(scene.problem())
    assert difference(scene.problem(), again) == ""


def test_numbers_keep_every_digit(tmp_path):
    """Of 1000 numbers of all sizes: what is read is what was written, bit for bit."""
    draws = np.random.default_rng(0)
    times = np.sort(draws.random(1000)) + 1e-300
    values = draws.standard_normal(1000) * 10.0 ** draws.integers(-300, 300, 1000)
    worn = jc.State({"B": {"bearing": np.stack([times, values])}})
    path = tmp_path / "scene.yaml"
    jc.write_scene(jc.Scene(MECHANISM, 1.0, state=worn), path)
    assert np.array_equal(jc.read_scene(path).state.worn["B"]["bearing"], worn.worn["B"]["bearing"])


LEFT_OUT = {"Condition", "FromFunction", "MuntheKaas"}

PUBLISHED = Path(__file__).parents[2] / "notebooks" / "_static" / "scene.schema.json"


@pytest.fixture(scope="module")
def validator():
    schema = jc.scene_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def text_of_schema():
    return json.dumps(jc.scene_schema(), indent=1, sort_keys=True) + "\n"


def test_published_schema_is_current():
    assert PUBLISHED.read_text() == text_of_schema()


def values(scene):
    return json.loads(scene_text(scene, ".json"))


@pytest.mark.parametrize("name", [*SCENES, *FURTHER, "asked"])
def test_what_is_written_fits_the_schema(validator, name):
    made = {"asked": asked} | SCENES | FURTHER
    scene = made[name]()
    validator.validate(values(scene if isinstance(scene, jc.Scene) else jc.Scene(scene)))


def test_every_class_is_in_the_schema(validator):
    defined = {name.rpartition(".")[2] for name in validator.schema["$defs"]}
    assert {*REACHABLE} - LEFT_OUT <= defined


def test_every_class_as_it_is_read_fits_its_schema(validator):
    defined = validator.schema["$defs"]
    for name in {*REACHABLE} - LEFT_OUT - {"Mechanism"}:
        full = next(place for place in defined if place.rpartition(".")[2] == name)
        schema = {"$ref": f"#/$defs/{full}", "$defs": defined}
        jsonschema.Draft202012Validator(schema).validate(of_class(REACHABLE[name][0]))


ROD, JOINT = ("mechanism", "bodies", "rod"), ("mechanism", "connections", "B", "joint")
# The place of a value, its name, and the wrong one; None: it is left out.
WRONG = [
    ((), "mechanism", None),
    (("mechanism",), "bodies", None),
    (ROD, "mass", -1.0),
    (ROD, "mass", "heavy"),
    (ROD, "weight", 1.0),
    (("mechanism", "connections", "A"), "joint", "Revolut"),
    (JOINT, "clearance", [1e-4]),
    (JOINT, "contact", None),
    (("run",), "duration", 0.0),
    (("run",), "integrator", "Euler"),
    (("responses", "force"), "kind", "Force"),
    ((), "jaxclear_scene", 2),
]


def test_what_the_schema_refuses_reading_refuses(validator, tmp_path):
    text, path = scene_text(asked(), ".json"), tmp_path / "scene.json"
    validator.validate(json.loads(text))
    for place, name, value in WRONG:
        wrong = json.loads(text)
        part = functools.reduce(dict.__getitem__, place, wrong)
        part.update({name: value})
        if value is None:
            part.pop(name)
        assert not validator.is_valid(wrong)
        path.write_text(json.dumps(wrong))
        with pytest.raises(ValueError, match=r"^scene\.json: "):
            jc.read_scene(path)


if __name__ == "__main__":
    PUBLISHED.write_text(text_of_schema())
