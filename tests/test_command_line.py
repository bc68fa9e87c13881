"""The command of the README on a small sample: it writes every figure and table it promises."""

import os
import re
import shlex
import subprocess
import sys
import time

import pandas
import pytest

import jaxclear as jc
from jaxclear.commands import cli
from jaxclear.ground import cache_folder
from jaxclear_command.cli import commands, main

STUDIES = {
    "four-bar": (
        "--samples 16 --duration 0.7 --turns 0.2 --quiet",
        {"runs": None, "monte_carlo": 16, "monte_carlo_summary": None, "sensitivity": None},
        7,
        "",
    ),
    "antenna": (
        "--duration 0.5",
        dict.fromkeys(
            ("motion", "stick_slip", "switchings_step", "pointing_step", "pointing_periodic")
        ),
        6,
        "",
    ),
    "3rsr": ("--cycles 4 --quiet", {"deviations": 6, "clearance": None, "volume": None}, 5, ""),
    "arm": (
        "--samples 16 --quiet",
        {"rests": 4, "lost_motion": 7, "slopes": 7, "choices": 128, "samples": 16, "design": 7},
        5,
        "All limits hold",
    ),
    "design": (
        "--accuracy 0.02 --quiet",
        dict.fromkeys(("antenna_design", "antenna_limits", "antenna_history")),
        2,
        "All limits hold",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("study", STUDIES)
def test_study_writes_figures_and_tables(study, tmp_path, capsys, keep_settings):
    asked, tables, figures, said = STUDIES[study]
    main([study, "--out", str(tmp_path), *asked.split()])
    names = {path.name for path in tmp_path.iterdir()}
    assert {f"{table}.csv" for table in tables} <= names
    assert sum(name.endswith(".png") for name in names) == figures
    for table, rows in tables.items():
        assert rows in (None, len(pandas.read_csv(tmp_path / f"{table}.csv")))
    printed = capsys.readouterr().out
    assert str(tmp_path) in printed and said in printed


@pytest.mark.slow
def test_wear_life_study_writes_figures_and_goes_on(tmp_path, capsys, keep_settings, monkeypatch):
    asked = ["wear-life", "--out", str(tmp_path), "--cycles", "1e4", "--quiet"]
    main(asked)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"settled.csv", "life.csv", "life.png", "groove.png", "store"}
    first = capsys.readouterr().out
    main(asked)
    # All but the time it took is the same, from the store.
    assert capsys.readouterr().out.rpartition(",")[0] == first.rpartition(",")[0]
    assert "1e+04 cycles of machine life" in first
    # A folder of another problem (of an earlier version, say) is told in a sentence.
    monkeypatch.setattr("jaxclear.commands.wear_life.SAVES", 501)
    with pytest.raises(SystemExit):
        main(asked)
    told = capsys.readouterr().err
    assert "Give another folder, or delete this one." in told and "Traceback" not in told


def test_compiled_programs_are_listed_and_removed(capsys, keep_settings, monkeypatch, tmp_path):
    main(["cache"])
    assert capsys.readouterr().out == "Nothing is kept: JAXCLEAR_CACHE is off.\n"
    monkeypatch.setenv("JAXCLEAR_CACHE", str(tmp_path))
    cache_folder.write(cache_folder.KERNEL, cache_folder.key_of("one"), bytes(2_000_000))
    main(["cache"])
    told = capsys.readouterr().out
    assert "1 kernels of time loops, 2.0 MB" in told and str(tmp_path) in told
    for left in ("1 files removed", "0 files removed"):
        main(["cache", "--clear"])
        assert left in capsys.readouterr().out


def test_parameters_are_listed_with_units(capsys, keep_settings):
    main(["parameters"])
    printed = capsys.readouterr().out
    assert 'connections["B"].joint.clearance' in printed and "kg m^2" in printed


MISTAKES = [
    (["four-barr"], 'no command "four-barr"; there are .* Did you mean "four-bar"'),
    ([], "a command must be named; there are .*four-bar"),
    (["four-bar", "--samples", "-4"], "whole number of at least 16"),
    (["four-bar", "--samples", "16.5"], "whole number of at least 16"),
    (["four-bar", "--duration", "0"], "a number of at least 0.01 s"),
    (["antenna", "--duration", "inf"], "a number of at least 0.01 s"),
    (["four-bar", "--turns", "two"], "two was given; it must be"),
    (["guide", "--clearance", "0"], "a number above 0 m"),
    (["guide", "--clearance", "nan"], "a number above 0 m"),
    (["guide", "--out", __file__], "is a file; it must be a folder"),
    (["guide", "--out", f"{__file__}/x"], "is a file; it must be a folder"),
    (["guide", "--out", ""], "it must be a folder"),
    (["wear-life", "--cycles", "0"], "a number of at least 1"),
    (["four-bar", "--sampels", "20"], 'Did you mean "--samples"'),
    (["guide", "--samples", "20"], 'no argument "--samples"; there are'),
    (["guide", "--clearance"], "jaxclear guide: --clearance: it must have a value"),
    (["guide", "--quiet=1"], "--quiet: it takes no value"),
    (["design", "--scene", "antena"], 'Did you mean "antenna"'),
    (["--verson"], 'Did you mean "--version"'),
    (["parameters", __file__, "all"], 'no argument "all"'),
]


@pytest.mark.parametrize(("given", "sentence"), MISTAKES, ids=range(len(MISTAKES)))
def test_command_line_answers_a_mistake_with_a_sentence(given, sentence, capsys):
    with pytest.raises(SystemExit) as ended:
        main(given)
    said = capsys.readouterr().err
    assert ended.value.code == 2 and re.search(sentence, said), said
    assert said.count("\n") == 1


def test_command_line_tells_its_version(capsys):
    main(["--version"])
    said = re.match(r"jaxclear (\S+).*\(JAX \S+, Python \S+\)", capsys.readouterr().out)
    assert said and said[1] == jc.__version__


ENDS = {
    "a run that ends early": (jc.SimulationError("it ended early.", None), 1),
    "an interrupt": (KeyboardInterrupt(), 130),
}


@pytest.mark.parametrize("end", ENDS)
def test_exit_code_tells_how_it_ended(end, monkeypatch, capsys, keep_settings):
    reason, code = ENDS[end]

    def stopped(scene):
        raise reason

    monkeypatch.setitem(cli.COMMANDS, "parameters", stopped)
    with pytest.raises(SystemExit) as ended:
        main(["parameters"])
    said = capsys.readouterr().err.strip()
    assert ended.value.code == code and re.fullmatch(r"jaxclear: (it|inter).*\.", said)


def every_command():
    group = commands()
    return {"jaxclear": group} | group.commands


@pytest.mark.parametrize("name", every_command())
def test_every_command_shows_examples_and_understands_them(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.yaml").touch()
    (tmp_path / "run3.csv").touch()
    (tmp_path / "store").mkdir()
    group, command = commands(), every_command()[name]
    assert command.examples
    for example in command.examples:
        program, *words = shlex.split(example.partition(">")[0])
        assert program == "jaxclear"
        if "--help" not in words:
            asked = group.commands[words[0]]
            assert not asked.make_context(words[0], words[1:]).args
    main(["--help"] if name == "jaxclear" else [name, "--help"])
    shown = capsys.readouterr().out
    assert "Examples:" in shown and all(example in shown for example in command.examples)


def test_the_command_is_a_module_too():
    """Where the script is not on the path."""
    asked = [sys.executable, "-m", "jaxclear", "four-barr"]
    answered = subprocess.run(asked, capture_output=True, text=True)
    assert answered.returncode == 2 and "four-bar" in answered.stderr


def test_a_slip_of_the_pen_is_answered_without_jax():
    """JAX takes two seconds to load; what it loads would stand among the modules."""
    ask = "import sys; from jaxclear_command.cli import main\ntry: main(['four-barr'])\n"
    ask += "except SystemExit: print('jax' in sys.modules, 'numpy' in sys.modules)"
    begun = time.perf_counter()
    answered = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True)
    # 0.1 s alone; a machine under load may take some times that
    assert time.perf_counter() - begun < 1.0 or os.getloadavg()[0] > 2
    assert answered.stdout.strip() == "False False" and "four-bar" in answered.stderr
