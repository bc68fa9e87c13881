"""The command line on a scene file: run, sample, report. What is wrong with a file is answered with
a sentence and exit code 2; what simulates shares one short scene."""

import dataclasses
import json
import re
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pandas
import pytest
import xarray

import jaxclear as jc
from jaxclear import commands
from jaxclear.files.scene import scene_text
from jaxclear.ground.printing import with_error
from jaxclear_command import command_list
from jaxclear_command.cli import main

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


def pendulum(**changes):
    """A rod on a pin with play, that falls."""
    bearing = jc.clearance.PlanarJournalBearing(
        contact=jc.contact.CarvalhoMartins(restitution=0.8), bearing_radius=10e-3, clearance=0.2e-3
    )
    rig = jc.Mechanism(
        bodies={"rod": jc.Body(mass=0.5, inertia=2e-3, com=(0.1, 0.0))},
        connections={"pin": jc.Connection(bearing, "ground", "rod")},
        loads={"gravity": jc.load.Gravity((0.0, -9.81))},
    )
    where = lambda rig: rig.connections["pin"].joint.clearance
    stated = {
        "duration": 0.02,
        "save": 41,
        "integrator": jc.integrator.FixedStep(2e-5),
        "variables": {"clearance": jc.Variable(where, tolerance=2e-5)},
        "responses": {"mean force": jc.response.MeanContactForce("pin")},
    }
    return jc.Scene(rig, **(stated | changes))


def standing():
    """Where the rod stands when it is turned."""
    places = {"duration": None, "save": None, "integrator": None, "variables": {}, "responses": {}}
    return pendulum(**places, positions={"pin": [0.0, 0.5, 1.0]})


@pytest.fixture
def here(tmp_path, monkeypatch, keep_settings):
    """A folder of its own to work in, with a scene."""
    monkeypatch.chdir(tmp_path)
    jc.write_scene(pendulum(), "scene.yaml")
    return tmp_path


IDENTIFY = ["identify", "scene.yaml", "records/run.csv", "--signal"]
MISTAKES = {
    r"SCENE is missing; it must be named \(file\)": ["run"],
    'no file scen.yaml. Did you mean "scene.yaml"': ["run", "scen.yaml"],
    r"\. is a folder; it must be a file": ["monte-carlo", "."],
    "empty.yaml: .*jaxclear_scene: 1": ["run", "empty.yaml"],
    "this scene states no variables": ["monte-carlo", "fixed.yaml"],
    "this scene states no duration": ["run", "endless.yaml"],
    'no joint "pni" in this .*; there is "pin". Did you': ["run", "other.yaml"],
    "clearance: is '0.2 mm'; it must be one number .m..": ["run", "unit.yaml"],
    'given positions and "duration"': ["run", "positions.yaml", "--duration", "1"],
    "whole number of at le": ["monte-carlo", "scene.yaml", "--samples", "1.5"],
    "nowhere is not there; it must be a folder": ["report", "nowhere"],
    "holds neither a campaign nor figures or tables": ["report", "."],
    'Did you mean "slider-crank"': ["example", "slider-crnk"],
    "in a folder that is there": ["report", ".", "--to", "no/a.html"],
    "RECORD is miss": ["identify", "scene.yaml", "--signal", "a=accelerometer:rod"],
    'no sensor "acelerometer".*Did you mean "accelerometer"': [*IDENTIFY, "a=acelerometer:rod"],
    "must say where its sensor is": [*IDENTIFY, "a=encoder"],
    'noise of signal "a" is "no"; it must be one number': [
        *(*IDENTIFY, "a=accelerometer:rod:x:noise=no"),
    ],
    'no column "b"': [*IDENTIFY, "b=accelerometer:rod:x"],
}


@pytest.mark.slow
@pytest.mark.filterwarnings("error:Attempting to set identical")
def test_positions_are_kept_and_reported(here, capsys):
    """The rod's centre of mass, 0.1 m away, and the journal that gravity presses downwards."""
    jc.write_scene(standing(), "standing.yaml")
    main(["run", "standing.yaml"])
    assert "stands at 3 positions" in capsys.readouterr().out
    table = pandas.read_csv("standing_run/positions.csv")
    np.testing.assert_allclose(table["rod.com x [m]"], 0.1 * np.cos([0, 0.5, 1]), atol=1e-9)
    np.testing.assert_allclose(table["pin.offset y [m]"], -0.2e-3, rtol=1e-9)
    main(["report", "standing_run"])
    page = (here / "standing_run" / "report.html").read_text()
    assert "Positions of standing.yaml" in page and "pin.offset" in page


@pytest.fixture(scope="module")
def wrong_files(tmp_path_factory):
    """A folder of scenes of which each lacks something."""
    folder = tmp_path_factory.mktemp("files")
    jc.write_scene(pendulum(), folder / "scene.yaml")
    jc.write_scene(pendulum(variables={}), folder / "fixed.yaml")
    jc.write_scene(pendulum(duration=None), folder / "endless.yaml")
    jc.write_scene(standing(), folder / "positions.yaml")
    text = (folder / "scene.yaml").read_text()
    (folder / "empty.yaml").write_text("mechanism: {}\n")
    (folder / "other.yaml").write_text(text.replace("joint: pin", "joint: pni"))
    (folder / "unit.yaml").write_text(text.replace("clearance: 0.0002", "clearance: 0.2 mm"))
    (folder / "records").mkdir()
    (folder / "records" / "run.csv").write_text("time,a\n0,0\n0.01,1\n0.02,0\n")
    return folder


@pytest.mark.parametrize("sentence", MISTAKES)
def test_a_mistake_with_a_file_ends_in_a_sentence(
    sentence, wrong_files, monkeypatch, capsys, keep_settings
):
    monkeypatch.chdir(wrong_files)
    with pytest.raises(SystemExit) as ended:
        main(MISTAKES[sentence])
    said = capsys.readouterr().err
    assert ended.value.code == 2 and re.search(sentence, said), said
    assert said.count("\n") == 1 and said.startswith(f"jaxclear {MISTAKES[sentence][0]}: ")


@pytest.mark.slow
@pytest.mark.parametrize("name", command_list.EXAMPLES)
def test_an_example_can_be_run_and_asked(name, here, capsys):
    main(["example", name])
    (here / "example.yaml").write_text(capsys.readouterr().out)
    scene = jc.read_scene(here / "example.yaml")
    assert scene.duration and scene.problem().response_names == tuple(scene.responses)


@pytest.mark.slow(sample=False)
def test_a_record_is_identified_and_reported(here, capsys):
    """A record that is a run of the scene with another clearance."""
    run = jc.simulate(pendulum().mechanism, 0.02, save=401)
    shown = np.asarray(jc.sensor.Accelerometer("rod", axis="x")(run))
    shown = shown + 0.5 * np.random.default_rng(0).standard_normal(401)
    record = pandas.DataFrame({"t": 1e3 * run.time, "a": shown})
    record.to_csv("record.csv", index=False, sep=";", decimal=",")
    asked = ["--signal", "a=accelerometer:rod:x:noise=0.5", "--runs", "64", "--quiet"]
    asked += ["--time", "t:ms:0.001"]
    main(["identify", "scene.yaml", "record.csv", *asked])
    assert "clearance" in capsys.readouterr().out
    table = pandas.read_csv("scene_identified/identified.csv")
    assert list(table["unknown"]) == ["clearance"]
    assert table["low"][0] < table["high"][0] and table["width"][0] > 0.01
    main(["report", "scene_identified"])
    assert "Identification of scene.yaml" in (here / "scene_identified/report.html").read_text()


EXAMPLES = {
    "slider-crank": jc.scenes.slider_crank,
    "four-bar": lambda: jc.scenes.four_bar("planar"),
    "antenna": lambda: jc.scenes.antenna("spatial", 100e-6),
}


def test_every_example_is_offered():
    files = (Path(commands.__file__).parent / "examples").glob("*.yaml")
    assert {file.stem for file in files} == set(EXAMPLES) == set(command_list.EXAMPLES)


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_is_the_ready_mechanism_as_it_is_written(name, tmp_path, capsys):
    main(["example", name])
    text = capsys.readouterr().out
    (tmp_path / "example.yaml").write_text(text)
    scene = jc.read_scene(tmp_path / "example.yaml")
    again = scene_text(dataclasses.replace(scene, mechanism=EXAMPLES[name]()))
    of_version = re.compile("^written_by: .*$", re.MULTILINE)
    assert of_version.sub("", again) == of_version.sub("", text)


def test_parameters_of_a_scene_file_are_listed(here, capsys):
    main(["parameters", "scene.yaml"])
    assert 'connections["pin"].joint.clearance' in capsys.readouterr().out


def test_a_scene_becomes_a_unit_for_other_simulators(here, capsys):
    gap = 'connections["pin"].joint.clearance'
    main(["fmu", "scene.yaml", "--out", "pendulum.fmu", "--parameter", f"gap={gap}"])
    assert "parameters: gap" in capsys.readouterr().out
    with zipfile.ZipFile(here / "pendulum.fmu") as archive:
        assert 'name="gap"' in archive.read("modelDescription.xml").decode()
    with pytest.raises(SystemExit):
        main(["fmu", "scene.yaml", "--input", "torque"])
    assert '"torque" must be NAME=NUMBER' in capsys.readouterr().err


def checked_page(path):
    """The text of a page that needs nothing beside itself."""
    text = path.read_text()
    assert "<script" not in text and "<link" not in text and "@import" not in text
    sources = re.findall(r'(?:src|href)="([^"]{0,30})', text)
    assert sources and all(one.startswith("data:image/png;base64,") for one in sources)
    if CHROMIUM:
        shown = subprocess.run(
            [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom", path.as_uri()],
            capture_output=True,
            text=True,
            timeout=120,
        ).stdout
        assert shown.count("<img") == text.count("<img") > 0
    return text


@pytest.mark.slow
def test_a_run_of_a_scene_is_kept_and_reported(here, capsys):
    main(["run", "scene.yaml", "--out", "first", "--duration", "0.01", "--quiet"])
    printed = capsys.readouterr().out
    assert "The run reached its end." in printed and "mean normal" in printed
    again = jc.simulate(
        pendulum().mechanism, 0.01, save=41, integrator=jc.integrator.FixedStep(2e-5)
    )
    with xarray.open_dataset(here / "first" / "run.nc") as kept:
        np.testing.assert_array_equal(kept["rod.com"], again.body("rod").com)
        assert kept["rod.com"].attrs["units"] == "m"
    assert jc.read_scene(here / "first" / "scene.yaml").duration == 0.01
    table = pandas.read_csv(here / "first" / "joints.csv")
    mean = float(jc.response.MeanContactForce("pin")(again))
    np.testing.assert_allclose(table["mean normal force [N]"], mean)
    peak = float(jc.response.PeakContactForce("pin")(again))
    np.testing.assert_allclose(table["peak normal force of a contact [N]"], peak)
    main(["report", "first"])
    page = checked_page(here / "first" / "report.html")
    assert "The run reached its end." in page and "jaxclear_scene: 1" in page


@pytest.mark.slow
def test_a_run_that_ends_early_is_kept_and_ends_with_code_1(here, capsys):
    short = pendulum(integrator=jc.integrator.Adaptive(max_steps=10))
    jc.write_scene(short, here / "short.yaml")
    with pytest.raises(SystemExit) as ended:
        main(["run", "short.yaml", "--quiet"])
    assert ended.value.code == 1 and "The run ended early" in capsys.readouterr().err
    assert "ended early" in json.loads((here / "short_run" / "run.json").read_text())["result"]


# A process in the background may be deaf to Ctrl-C.
BEGIN = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from jaxclear_command.cli import main
main(sys.argv[1:])
"""


@pytest.mark.slow(sample=False)
def test_monte_carlo_of_a_scene_is_interrupted_goes_on_and_is_reported(here, capsys):
    asked = ["monte-carlo", "scene.yaml", "--samples", "3e4", "--chunk", "16", "--quiet"]
    begun = subprocess.Popen(
        [sys.executable, "-c", BEGIN, *asked, "--out", "store"], stderr=subprocess.PIPE, text=True
    )
    mark = here / "store" / "chunks"
    for _ in range(1200):
        if mark.exists() and begun.poll() is None:
            break
        time.sleep(0.1)
    begun.send_signal(signal.SIGINT)
    said = begun.communicate(timeout=60)[1]
    assert begun.returncode == 130 and "are kept in store; ask the same again" in said, said
    with pytest.raises(SystemExit) as ended:
        main([*asked, "--out", "store", "--seed", "1"])
    assert ended.value.code == 2 and "seed=0, not 1" in capsys.readouterr().err
    main(["report", "store"])
    assert "the same command goes on" in checked_page(here / "store" / "report.html")


@pytest.mark.slow
def test_monte_carlo_of_a_scene_is_that_of_the_library(here, capsys):
    asked = ["monte-carlo", "scene.yaml", "--samples", "64", "--out", "store", "--quiet"]
    main(asked)
    first = capsys.readouterr().out
    main(asked)
    assert capsys.readouterr().out == first and "64 samples, 0 failed" in first
    plain = jc.monte_carlo(pendulum().problem(), 64)
    kept = jc.open_campaign(here / "store")
    np.testing.assert_array_equal(kept.values, plain.values)
    np.testing.assert_allclose(kept.responses["mean force"], plain.responses["mean force"])
    main(["report", "store", "--to", "page.html"])
    page = checked_page(here / "page.html")
    mean = plain.mean("mean force")
    told = with_error(float(mean.value), float(mean.error))
    assert told in page.replace("\u00a0", " ")
    assert "jaxclear_scene: 1" in page and "jaxlib" in page


@pytest.mark.slow
def test_the_yield_of_a_drawing_is_printed_and_kept(here, capsys):
    """Yield at rest and in motion, a share for each line, the worst case, and the picture."""
    lines = {
        "B": "20 H7/f7",
        "crank hole": jc.tolerance.Position(0.05e-3, marker="A.parent"),
        "follower hole": jc.tolerance.Position(0.05e-3, marker="B.child", at_mmc="B hole"),
    }
    rig = jc.scenes.four_bar("planar", 0.03e-3, friction=False, wear=False)
    integrator = jc.integrator.ImplicitStep(5e-5)
    error = {"error": jc.response.LargestError("D")}
    how = {"duration": 0.02, "save": 11, "integrator": integrator, "responses": error}
    jc.write_scene(jc.Scene(rig, **how, drawing=lines), "bar.yaml")
    main(["yield", "bar.yaml", "--limit", "error: 0.4e-3", "--samples", "32", "--quiet"])
    said = capsys.readouterr().out
    for words in ("Yield at rest: ", "Yield in motion: ", "Worst case at rest: ", "20 H7/f7"):
        assert words in said
    kept = sorted(file.name for file in (here / "bar_yield").iterdir())
    figures = ["drawing.png", "shares_at_rest.png", "shares_in_motion.png"]
    assert kept == sorted(["drawing.csv", "shares.csv", *figures])


@pytest.mark.parametrize(
    ("limit", "sentence"),
    [
        ("mean force: 3", "states no drawing"),
        ("error", "write a response and its largest value"),
    ],
)
def test_a_yield_that_cannot_be_told_gets_a_sentence(limit, sentence, here, capsys):
    with pytest.raises(SystemExit) as end:
        main(["yield", "scene.yaml", "--limit", limit, "--quiet"])
    assert end.value.code != 0 and re.search(sentence, capsys.readouterr().err)
