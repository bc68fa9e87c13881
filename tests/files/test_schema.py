"""The JSON schema of scene files says what reading says, as far as a schema can, and the published
one is current. `python -m tests.files.test_schema` writes it anew.
"""

import json
from pathlib import Path

import jsonschema
import pytest

import jaxclear as jc
from jaxclear.files.scene import scene_text
from tests.files.test_round_trip import FURTHER, REACHABLE, SCENES, asked, of_class

# Told by a function, so no file holds it; solvers are diffrax's business.
LEFT_OUT = {
    "Condition",
    "FollowingErrors",
    "FromFunction",
    "MuntheKaas",
    "Stages",
    "TakingImpactSpeeds",
}

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


@pytest.mark.parametrize("name", sorted({*REACHABLE} - LEFT_OUT - {"Mechanism"}))
def test_every_class_as_it_is_read_fits_its_schema(validator, name):
    defined = validator.schema["$defs"]
    full = next(place for place in defined if place.rpartition(".")[2] == name)
    schema = {"$ref": f"#/$defs/{full}", "$defs": defined}
    jsonschema.Draft202012Validator(schema).validate(of_class(REACHABLE[name][0]))


@pytest.mark.parametrize(
    "change",
    [
        lambda v: v.pop("mechanism"),
        lambda v: v["mechanism"].pop("bodies"),
        lambda v: v["mechanism"]["bodies"]["rod"].update(mass=-1.0),
        lambda v: v["mechanism"]["bodies"]["rod"].update(mass="heavy"),
        lambda v: v["mechanism"]["bodies"]["rod"].update(weight=1.0),
        lambda v: v["mechanism"]["connections"]["A"].update(joint="Revolut"),
        lambda v: v["mechanism"]["connections"]["B"]["joint"].update(clearance=[1e-4]),
        lambda v: v["mechanism"]["connections"]["B"]["joint"].pop("contact"),
        lambda v: v["run"].update(duration=0.0),
        lambda v: v["run"].update(integrator="Euler"),
        lambda v: v["responses"]["force"].update(kind="Force"),
        lambda v: v.update(jaxclear_scene=2),
    ],
)
def test_what_the_schema_refuses_reading_refuses(validator, change, tmp_path):
    wrong = values(asked())
    validator.validate(wrong)
    change(wrong)
    assert not validator.is_valid(wrong)
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(wrong))
    with pytest.raises(ValueError, match=r"^scene\.json: "):
        jc.read_scene(path)


if __name__ == "__main__":
    PUBLISHED.write_text(text_of_schema())
