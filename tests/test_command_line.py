"""The command of the README on a small sample: it writes every figure and table it promises."""

import os
import re
import subprocess
import sys
import time

import pandas
import pytest

from jaxclear_command.cli import main


@pytest.mark.slow
def test_four_bar_study_writes_figures_and_tables(tmp_path, capsys, keep_settings):
    main(
        [
            "four-bar",
            "--out",
            str(tmp_path),
            "--samples",
            "16",
            "--duration",
            "0.7",
            "--turns",
            "0.2",
            "--quiet",
        ]
    )
    names = {path.name for path in tmp_path.iterdir()}
    assert {"runs.csv", "monte_carlo.csv", "monte_carlo_summary.csv", "sensitivity.csv"} <= names
    assert sum(name.endswith(".png") for name in names) == 7
    assert len(pandas.read_csv(tmp_path / "monte_carlo.csv")) == 16
    assert str(tmp_path) in capsys.readouterr().out


@pytest.mark.slow
def test_antenna_study_writes_figures_and_tables(tmp_path, capsys, keep_settings):
    main(["antenna", "--out", str(tmp_path), "--duration", "0.5"])
    names = {path.name for path in tmp_path.iterdir()}
    assert {
        "motion.csv",
        "stick_slip.csv",
        "switchings_step.csv",
        "pointing_step.csv",
        "pointing_periodic.csv",
    } <= names
    assert sum(name.endswith(".png") for name in names) == 6
    assert str(tmp_path) in capsys.readouterr().out


@pytest.mark.slow
def test_3rsr_study_writes_figures_and_tables(tmp_path, capsys, keep_settings):
    main(["3rsr", "--out", str(tmp_path), "--cycles", "4", "--quiet"])
    names = {path.name for path in tmp_path.iterdir()}
    assert {"deviations.csv", "clearance.csv", "volume.csv"} <= names
    assert sum(name.endswith(".png") for name in names) == 5
    assert len(pandas.read_csv(tmp_path / "deviations.csv")) == 6
    assert str(tmp_path) in capsys.readouterr().out


@pytest.mark.slow
def test_wear_life_study_writes_figures_and_goes_on(tmp_path, capsys, keep_settings):
    asked = ["wear-life", "--out", str(tmp_path), "--cycles", "1e4", "--quiet"]
    main(asked)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"settled.csv", "life.csv", "life.png", "groove.png", "store"}
    first = capsys.readouterr().out
    main(asked)
    # All but the time it took is the same, from the store.
    assert capsys.readouterr().out.rpartition(",")[0] == first.rpartition(",")[0]
    assert "1e+04 cycles of machine life" in first


def test_parameters_are_listed_with_units(capsys, keep_settings):
    main(["parameters"])
    printed = capsys.readouterr().out
    assert 'connections["B"].joint.clearance' in printed and "kg m^2" in printed


MISTAKES = {
    "study": (["four-barr"], 'no study "four-barr"; there are .* Did you mean "four-bar"'),
    "nothing": ([], "a study must be named; there are four-bar"),
    "negative samples": (["four-bar", "--samples", "-4"], "whole number of at least 16"),
    "part of a sample": (["four-bar", "--samples", "16.5"], "whole number of at least 16"),
    "no duration": (["four-bar", "--duration", "0"], "a number of at least 0.01 s"),
    "endless": (["antenna", "--duration", "inf"], "a number of at least 0.01 s"),
    "turns by text": (["four-bar", "--turns", "two"], "two was given; it must be"),
    "no gap": (["guide", "--clearance", "0"], "a number above 0 m"),
    "gap that is no number": (["guide", "--clearance", "nan"], "a number above 0 m"),
    "a file": (["guide", "--out", __file__], "is a file; it must be a folder"),
    "within a file": (["guide", "--out", f"{__file__}/x"], "is a file; it must be a folder"),
    "no folder": (["guide", "--out", ""], "it must be a folder"),
    "no life": (["wear-life", "--cycles", "0"], "a number of at least 1"),
    "argument": (["four-bar", "--sampels", "20"], 'Did you mean "--samples"'),
    "another study's": (["guide", "--samples", "20"], 'no argument "--samples"; there are'),
    "a word": (["parameters", "all"], 'no argument "all"'),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_command_line_answers_a_mistake_with_a_sentence(mistake, capsys):
    given, sentence = MISTAKES[mistake]
    with pytest.raises(SystemExit) as ended:
        main(given)
    said = capsys.readouterr().err
    assert ended.value.code == 2 and re.search(sentence, said), said
    assert said.count("\n") == 1


def test_command_line_tells_its_version(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0 and capsys.readouterr().out.startswith("jaxclear ")


def test_a_slip_of_the_pen_is_answered_without_jax():
    """JAX takes two seconds to load; what it loads would stand among the modules."""
    ask = "import sys; from jaxclear_command.cli import main\ntry: main(['four-barr'])\n"
    ask += "except SystemExit: print('jax' in sys.modules, 'numpy' in sys.modules)"
    begun = time.perf_counter()
    answered = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True)
    # 0.1 s alone; a machine under load may take some times that
    assert time.perf_counter() - begun < 1.0 or os.getloadavg()[0] > 2
    assert answered.stdout.strip() == "False False" and "four-bar" in answered.stderr


@pytest.mark.slow
def test_design_study_writes_figures_and_goes_on(tmp_path, capsys, keep_settings):
    asked = ["design", "--out", str(tmp_path), "--accuracy", "0.02", "--quiet"]
    main(asked)
    names = {path.name for path in tmp_path.iterdir()}
    assert {"antenna_design.csv", "antenna_limits.csv", "antenna_history.csv"} <= names
    assert sum(name.endswith(".png") for name in names) == 2
    assert "All limits hold" in capsys.readouterr().out
