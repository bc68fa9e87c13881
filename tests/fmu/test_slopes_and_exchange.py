"""A unit's slopes are those of `simulate`, and refused where it refuses them; for model exchange it
moves under another program's integrator as under `Adaptive`."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from tests.fmu.test_export import CLEARANCE, TORQUE, rig
from tests.rigs import fmi_host

OUTPUTS = {"crank": ("O", "coordinate"), "slider": ("G", "coordinate")}


def export(path, step, slopes):
    return jc.export_fmu(
        rig(),
        path,
        integrator=jc.integrator.FixedStep(step),
        inputs={"torque": TORQUE},
        outputs=OUTPUTS,
        parameters={"clearance": CLEARANCE},
        slopes=slopes,
    )


def test_a_slope_is_that_of_runs_beside_and_is_refused_after_touches(tmp_path):
    """Before the first touch a run is smooth in the torque, and differences are right to the square
    of their width. 6 ms into the run touches have passed from one step to the next: differences of
    runs have the wrong sign there, and the slope in other steps is another."""
    path = tmp_path / "slopes.fmu"
    made = export(path, 2e-5, ["torque"])
    assert made.size < 100_000
    instance = fmi_host.Instance(fmi_host.Unit(path))
    slopes = []
    for _ in range(6):
        assert instance.step(1e-3) == fmi_host.OK
        slopes.append(instance.slope("torque", *OUTPUTS))
    step = jc.integrator.FixedStep(2e-5)
    end = lambda torque: jc.simulate(rig(torque), 2e-3, save=2, integrator=step, verify=False)
    ends = [float(end(0.3 + h).coordinate("O")[-1]) for h in (1e-4, -1e-4)]
    assert slopes[1][0] == pytest.approx((ends[0] - ends[1]) / 2e-4, rel=1e-9)
    assert np.isnan(slopes[5]).all()
    assert "A slope at 0.006 s is nan" in instance.messages[-1]


@pytest.mark.slow(sample=False)
def test_slopes_are_those_of_simulate(tmp_path):
    """Through some ten touches, along two numbers, where simulate refuses them too."""
    step = jc.integrator.FixedStep(1e-6)
    export(tmp_path / "slopes.fmu", 1e-6, ["torque", "clearance"])
    unit = fmi_host.Unit(tmp_path / "slopes.fmu")

    for name, where in {"torque": TORQUE, "clearance": CLEARANCE}.items():

        def motion(number, where=where):
            mechanism = eqx.tree_at(where, rig(), number)
            run = jc.simulate(mechanism, 12e-3, save=13, integrator=step, verify=False, throw=False)
            return jnp.stack([run.coordinate(joint)[1:] for joint in ("O", "G")], axis=1)

        expected = jax.jvp(motion, (jnp.asarray(where(rig())),), (jnp.ones(()),))[1]
        instance, found = fmi_host.Instance(unit), []
        for _ in range(12):
            assert instance.step(1e-3) == fmi_host.OK
            found.append(instance.slope(name, *OUTPUTS))
        # A run beside its end is judged by the largest slope until then, a unit by the slope.
        assert np.array_equal(np.isnan(found[-1]), np.isnan(expected[-1]))
        known = np.isfinite(found)
        assert known.sum() >= 18
        scale = np.abs(np.asarray(expected)[known]).max()
        difference = np.abs(np.array(found) - np.asarray(expected))[known]
        assert np.all(difference <= 1e-9 * scale)


def test_slopes_that_steps_do_not_know_are_refused(tmp_path):
    """Counted steps do not follow touches."""
    with pytest.raises(ValueError, match="would not be those of the motion"):
        jc.export_fmu(
            rig(),
            tmp_path / "no.fmu",
            integrator=jc.integrator.FixedStep(1e-5, steps_per_save=10),
            inputs={"torque": TORQUE},
            slopes=["torque"],
        )


def exported_for_exchange(path):
    return jc.export_fmu(
        rig(),
        path,
        integrator=jc.integrator.Adaptive(),
        inputs={"torque": TORQUE},
        outputs=OUTPUTS,
        kinds=("co-simulation", "model exchange"),
    )


def test_model_exchange_moves_as_adaptive_over_many_touches(tmp_path):
    """CVode of fmpy finds the touches by their indicators."""
    fmpy = pytest.importorskip("fmpy")
    path = tmp_path / "exchange.fmu"
    exported_for_exchange(path)
    count, end = 91, 0.09
    finer = jc.integrator.Adaptive(rtol=1e-10, atol=1e-13)
    run = jc.simulate(rig(), end, save=jc.Saving(count, 20), integrator=finer, verify=False)
    assert np.sum(run.noted.counts) >= 40  # touches and releases
    found = fmpy.simulate_fmu(
        str(path),
        fmi_type="ModelExchange",
        solver="CVode",
        stop_time=end,
        output_interval=1e-3,
        relative_tolerance=1e-10,
        record_events=False,
    )
    for name, joint in {"crank": "O", "slider": "G"}.items():
        np.testing.assert_allclose(found[name], run.coordinate(joint), rtol=0, atol=1e-6)


def test_what_is_no_rate_is_refused_for_exchange(tmp_path):
    means = {"integrator": jc.integrator.MoreauJean(1e-4), "kinds": ("model exchange",)}
    hinge = {"O": jc.Connection(jc.joint.Revolute(), "ground", "arm")}
    with pytest.raises(ValueError, match="means over its steps: take co-simulation"):
        jc.export_fmu(jc.Mechanism({"arm": jc.Body(1.0, 1.0)}, hinge), tmp_path / "no.fmu", **means)
