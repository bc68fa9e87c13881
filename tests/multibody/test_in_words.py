"""What `print` shows of a mechanism, of a joint's contacts, of derivatives: numbers with units."""

import numpy as np
import pandas
import pytest

import jaxclear as jc
from jaxclear.studies.sensitivity.derivative import Estimate, Sensitivity, confirmed


@pytest.mark.parametrize("scene", jc.scenes.__all__)
def test_print_shows_every_number_with_its_unit(scene):
    rig = getattr(jc.scenes, scene)()
    shown = str(rig)
    assert not set("\t{}") & set(shown) and "Array" not in shown
    for name in (*rig.bodies, *rig.connections, *rig.loads):
        assert any(line.strip().startswith(name) for line in shown.splitlines())
    for row in rig.parameters().to_dict("records"):
        place = row["name"].rpartition(".")[2].partition("[")[0]
        unit = "" if row["unit"] == "1" else f" {row['unit']}"
        many = isinstance(row["value"], list)
        if "stabilisation" not in row["name"] and place not in ("at", "axis") and not many:
            values = f"{row['value']:.6g}"
            word = "turned by" if place == "quaternion" else place
            assert any(values in part and unit in part for part in shown.split(word)[1:]), row


def test_print_shows_a_start_in_the_units_of_its_joint():
    shown = str(jc.scenes.slider_crank())
    assert "G  0.17 m" in shown and "com (0.025, 0) m" in shown
    assert "clearance 0.0002 m" in shown and "speed 50 rad/s" in shown


def test_numbers_along_a_sliding_joint_have_the_units_of_lengths_and_forces():
    """They were N m/rad and rad, of a press and its spring."""
    drive = jc.drive.Harmonic(0.1, frequency=3.0)
    shown = str(
        jc.Mechanism(
            {"ram": jc.Body(1.0, 1.0), "tool": jc.Body(1.0, 1.0)},
            {
                "P": jc.Connection(jc.joint.Prismatic(drive=drive), "ground", "ram"),
                "Q": jc.Connection(jc.joint.Prismatic(), "ram", "tool"),
            },
            {
                "spring": jc.load.JointSpring("Q", 2e4, damping=3.0),
                "push": jc.load.JointTorque("Q", 5.0),
            },
        )
    )
    assert "stiffness 20000 N/m, rest 0 m, damping 3 N s/m" in shown
    assert shown.endswith("JointTorque connection Q, value 5 N")
    assert "amplitude 0.1 m, frequency 3 Hz, phase 0 rad, offset 0 m" in shown


def test_start_and_loads_of_a_joint_with_clearance_have_the_units_of_its_coordinate():
    """They were without a unit, and along a guide in N m/rad."""
    law = jc.contact.Hertz(stiffness=1e9)
    shown = str(
        jc.Mechanism(
            {"wheel": jc.Body(1.0, 1e-3), "slider": jc.Body(1.0, 1e-3)},
            {
                "B": jc.Connection(jc.clearance.PlanarJournalBearing(law), "ground", "wheel"),
                "G": jc.Connection(jc.clearance.SliderGuide(law), "ground", "slider", axis="x"),
            },
            {"spring": jc.load.JointSpring("G", 2e4)},
            start={"B": 0.25},
            speeds={"B": 300.0, "G": 0.5},
        )
    )
    assert "B  0.25 rad" in shown and "B  300 rad/s" in shown and "G  0.5 m/s" in shown
    assert "stiffness 20000 N/m" in shown


@pytest.mark.slow
def test_contact_table_labels_its_columns_with_units():
    run = jc.simulate(jc.scenes.four_bar(wear=False), 1e-3, save=3)
    history = run.contact("B")
    table = history.table()
    assert table.index.name == "time [s]"
    assert "normal force, upper end [N]" in table and "indentation, lower collar [m]" in table
    assert "offset x [m]" in table and "torque z [N m]" in table
    np.testing.assert_array_equal(
        table["indentation, upper end [m]"], np.asarray(history.indentation)[:, 1]
    )
    guide = jc.simulate(
        jc.scenes.guide(), 2e-3, save=3, integrator=jc.integrator.NonColliding(1e-3)
    )
    assert "normal force, lower back [N]" in guide.contact("P").table()


def test_print_of_derivatives_shows_the_derivative():
    """In a narrow terminal too, where pandas leaves out the columns in the middle."""
    problem = jc.Problem(
        jc.scenes.slider_crank(),
        {"mean force": jc.response.MeanContactForce("B")},
        {
            "clearance": jc.Variable(
                lambda rig: rig.connections["B"].joint.clearance, tolerance=1e-5
            )
        },
        duration=1e-3,
    )
    found = confirmed(
        "mean force",
        "clearance",
        {"regression": Estimate(123.25, 1.0), "differences": Estimate(123.5, 2.0)},
    )
    study = Sensitivity({("mean force", "clearance"): found}, _Sample(problem))
    with pandas.option_context("display.width", 80, "display.max_columns", 4):
        shown = str(study.table())
    assert "derivative" in shown and "123.2 ± 1.0" in shown


class _Sample:
    """What a table of derivatives asks of a sample."""

    count = 64

    def __init__(self, problem):
        self.problem = problem
