"""The command of the README on a small sample: it writes every figure and table it promises."""

import pandas
import pytest

from jaxclear.commands.cli import main


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


def test_parameters_are_listed_with_units(capsys, keep_settings):
    main(["parameters"])
    printed = capsys.readouterr().out
    assert 'connections["B"].joint.clearance' in printed and "kg m^2" in printed
