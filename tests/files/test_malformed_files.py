"""Malformed scene files end in a sentence that names line or place, never in a traceback; nothing
in them is run; time and memory are bounded.

A mutated file is right where it still reads as a scene, or where it is refused with one sentence.
"""

import json
import random
import time
import warnings

import pytest

import jaxclear as jc
from jaxclear.files.scene import scene_text
from jaxclear.files.text import DEEPEST, MOST_VALUES, values_of
from tests.files.test_round_trip import SCENES, asked
from tests.rigs.cells import slow

# Pieces that break a file, or ask for what is not there.
PIECES = [
    *("!!python/object/apply:os.system ['touch broken']", "!!python/name:os.system"),
    *("!!binary aGVsbG8=", "&a [*a, *a]", "*nothing", "<<: *nothing", "- ", ": ", "? ", "\t"),
    *"{}[]'\"#%@|>~0é\x00\ud7ff",
    *("null", "true", ".nan", ".inf", "-1", "1e999", "9" * 30, "9" * 5000, "1_000", "0x10"),
    *("2001-01-01", "kind: Revolute", "kind: ContactForce", "kind: os.system", "---", "..."),
    *("kind: __import__('os').system('touch broken')", "../../etc/passwd"),
]


def mutated(text, rng):
    """A text with one to three slips."""
    for _ in range(rng.randint(1, 3)):
        lines = text.splitlines(keepends=True) or [""]
        where, at = rng.randrange(len(lines)), rng.randrange(len(text) + 1)
        line, other, way = lines[where], rng.choice(lines), rng.randrange(8)
        if way == 0:
            text = text[:at] + rng.choice(PIECES) + text[at:]
        elif way == 1:
            text = text[:at] + text[at + rng.randint(1, 40) :]
        elif way == 2:
            letter = chr(rng.choice([rng.randrange(32, 127), rng.randrange(1, 0x2FF)]))
            text = text[:at] + letter + text[at + 1 :]
        else:
            head, colon, _ = line.partition(":")
            lines[where] = {
                3: "",
                4: other + line,
                5: " " * rng.randint(1, 4) + line,
                6: f"{head}{colon} {rng.choice(PIECES)}\n",
                7: line[: rng.randint(0, len(line))] + other,
            }[way]
            text = "".join(lines)
    return text


TEXTS = {".yaml": {}, ".json": {}}


def texts(ending):
    if not TEXTS[ending]:
        made = {name: jc.Scene(make()) for name, make in SCENES.items()} | {"asked": asked()}
        TEXTS[ending].update({name: scene_text(scene, ending) for name, scene in made.items()})
    return TEXTS[ending]


def verdict(path):
    """ "read" or "refused" of a file; fails where it is neither."""
    with warnings.catch_warnings():
        # Of numbers beyond what mechanisms have.
        warnings.simplefilter("ignore")
        try:
            jc.read_scene(path)
        except ValueError as error:
            said = str(error)
            assert said.startswith(f"{path.name}: ")
            assert said.endswith((".", "?"))
            assert "Traceback" not in said and " at 0x" not in said
            assert len(said) < 2000
            return "refused"
    return "read"


def run_mutations(folder, count, first=0):
    """Counts of verdicts of mutated files, and the longest time [s] of one."""
    found, longest = {"read": 0, "refused": 0}, 0.0
    for seed in range(first, first + count):
        rng = random.Random(seed)
        ending = rng.choice([".yaml", ".yaml", ".json"])
        name = rng.choice(sorted(texts(ending)))
        path = folder / f"scene{ending}"
        path.write_bytes(mutated(texts(ending)[name], rng).encode("utf-8", "surrogatepass"))
        begun = time.process_time()
        try:
            found[verdict(path)] += 1
        except AssertionError:
            raise
        except BaseException as error:
            raise AssertionError(f"file of seed {seed}: {type(error).__name__}: {error}") from error
        longest = max(longest, time.process_time() - begun)
    assert not (folder / "broken").exists()
    return found, longest


@pytest.mark.parametrize("count", [100, *slow(5_000)])
def test_mutated_files_end_in_sentences(count, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found, longest = run_mutations(tmp_path, count)
    assert found["refused"] > 0.4 * count and sum(found.values()) == count
    # CPU time of one file; usually some hundredths.
    assert longest < 5.0


def test_a_tag_is_no_object(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "scene.yaml"
    path.write_text("jaxclear_scene: !!python/object/apply:os.system ['touch broken']\n")
    with pytest.raises(ValueError, match=r"line 1: the tag .* asks for an object"):
        jc.read_scene(path)
    assert not (tmp_path / "broken").exists()


WRONG = [
    ("", "scene.yaml: is empty"),
    ("jaxclear_scene: 1\n", "has no mechanism"),
    ("mechanism: {}\n", 'has no "jaxclear_scene: 1"'),
    ("jaxclear_scene: 7\n", "line 1, jaxclear_scene: is 7; this version of jaxclear reads 1"),
    ("a: [1, 2\nb: 3\n", r"line 2: .*\(YAML\)"),
    ("a: 1\na: 2\n", 'line 2: the name "a" stands twice'),
    ("a: *b\n", 'line 1: the alias "b" names nothing above it'),
    ("a: &b [*b]\n", 'line 1: the alias "b" names nothing above it'),
    ("--- 1\n--- 2\n", "line 2: a second document begins"),
    ("a: " + "[" * 100_000, f"nested more than {DEEPEST} deep"),
    ("- 1\n", "must be a mapping"),
    ("{", r"line 1: .*\(JSON\)"),
    ('{"a": 1, "a": 2}', 'the name "a" stands twice'),
    ('{"a": NaN}', "holds NaN"),
    ("[" * 5000 + "]" * 5000, "nested more than"),
    ('{"a": ' + "9" * 5000 + "}", "thousands of digits"),
]


@pytest.mark.parametrize(("text", "sentence"), WRONG, ids=range(len(WRONG)))
def test_what_is_wrong_is_named_by_its_line(text, sentence, tmp_path):
    path = tmp_path / ("scene.json" if text[:1] in ("{", "[") else "scene.yaml")
    path.write_text(text)
    with pytest.raises(ValueError, match=sentence):
        jc.read_scene(path)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("clearance: 0.0002", "clearance: -1", "B.*clearance = -1 m; it must be above 0"),
        ("clearance: 0.0002", "clearance: 0.2 mm", r"clearance: is '0.2 mm'; it must be one num"),
        ("clearance: 0.0002", "clearence: 1e-4", 'clearence".*Did you mean "clearance"'),
        ("kind: Ambrosio", "kind: Ambrosia", 'no kind "Ambrosia".*Did you mean "Ambrosio"'),
        ("mass: 0.3", "weight: 0.3", 'no argument "weight"'),
        ("duration: 0.01", "durations: 1", 'Did you mean "duration"'),
        ('connections["B"].joint.clearance', "connections.C.joint", 'no part "C" there'),
    ],
)
def test_a_slip_is_named_by_its_place_and_what_was_meant(old, new, sentence, tmp_path):
    path, text = tmp_path / "scene.yaml", texts(".yaml")["asked"]
    assert old in text
    path.write_text(text.replace(old, new, 1))
    line = next(n for n, one in enumerate(path.read_text().splitlines(), 1) if new in one)
    with pytest.raises(ValueError, match=sentence) as refused:
        jc.read_scene(path)
    told = int(str(refused.value).split("line ")[1].split(",")[0])
    # What a class itself refuses is told by where it begins.
    assert line - 20 <= told <= line


def test_aliases_cannot_blow_up(tmp_path):
    """A billion laughs: ten lines that would stand for 10^9 values."""
    lines = ["a0: &a0 [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 9)]
    path = tmp_path / "scene.yaml"
    path.write_text("\n".join(lines))
    begun = time.process_time()
    with pytest.raises(ValueError, match=f"more than {MOST_VALUES} values"):
        jc.read_scene(path)
    assert time.process_time() - begun < 1.0


@pytest.mark.parametrize("values", ["0", *slow('"ab"', "{}", '"k": [1]'), '"k\\",[": 1'])
def test_values_of_json_are_counted_before_they_are_read(values, tmp_path):
    """Millions of values in 31 MB took 160 s and 1.5 GB before they were refused."""
    path, named = tmp_path / "scene.json", ":" in values
    opened, closed = "{}" if named else "[]"
    many = lambda count: opened + ",".join([values] * count) + closed
    path.write_text(many(MOST_VALUES + 2))
    begun = time.process_time()
    with pytest.raises(ValueError, match=f"more than {MOST_VALUES} values"):
        jc.read_scene(path)
    assert time.process_time() - begun < 2.0
    for few in (0, 1, 7):
        assert values_of(many(few)) == 1 + few * (2 if "[1]" in values else 1)


def test_a_shared_law_may_stand_behind_an_anchor(tmp_path):
    text = texts(".yaml")["slider_crank"]
    law = "{young_modulus: 207000000000.0, poisson_ratio: 0.3}"
    text = text.replace(f"inner: {law}", f"inner: &steel {law}").replace(
        f"outer: {law}", "outer: *steel"
    )
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    assert "*steel" in text
    assert scene_text(jc.read_scene(path)) == texts(".yaml")["slider_crank"]


def test_a_function_is_refused_by_its_place_and_nothing_is_written(tmp_path):
    mechanism = jc.scenes.slider_crank(drive=jc.drive.Position(lambda time: 3.0 * time))
    path = tmp_path / "scene.yaml"
    sentence = r'connections\["O"\].joint.drive.function is the function <lambda>: a file holds da'
    with pytest.raises(ValueError, match=sentence):
        jc.write_scene(mechanism, path)
    assert not path.exists()


def test_what_is_no_file_is_named(tmp_path):
    for name, sentence in (("none.yaml", "does not exist"), ("", "is a folder")):
        with pytest.raises(ValueError, match=sentence):
            jc.read_scene(tmp_path / name)
    path = tmp_path / "scene.txt"
    path.write_text(json.dumps({}))
    with pytest.raises(ValueError, match=r'ends in ".txt"; a scene file ends in .yaml'):
        jc.read_scene(path)
    (tmp_path / "scene.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="is no text in UTF-8"):
        jc.read_scene(tmp_path / "scene.yaml")
