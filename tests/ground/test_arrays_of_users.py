"""What is built of a user's NumPy arrays does not change when these do: JAX may take the memory of
an array as its own, where it happens to begin at a multiple of 64 bytes."""

import jax
import numpy as np
import pytest

import jaxclear as jc


def aligned(*values):
    """An array whose memory JAX can take as it is."""
    memory = np.zeros(8 * len(values) + 64, np.uint8)
    begin = -memory.ctypes.data % 64
    array = memory[begin : begin + 8 * len(values)].view(float)
    array[:] = values
    return array


SENSOR = {"a": jc.sensor.Encoder("J")}
BUILDERS = {
    "number": lambda x: jc.Body(x[:1].reshape(()), 1.0),
    "vector": lambda x: jc.Marker("cart", x[:3]),
    "times of a table": lambda x: jc.TimeTable(x, [0.0, 1.0, 2.0, 3.0], "linear"),
    "values of a table": lambda x: jc.TimeTable([0.0, 1.0, 2.0, 3.0], x, "linear"),
    "breaks": lambda x: jc.integrator.Adaptive(breaks=x),
    "depths": lambda x: jc.State({"B": {"bearing": x}}),
    "times of a record": lambda x: jc.Measurement(x, {"a": [0.0, 1.0, 2.0, 3.0]}, SENSOR).time,
    "signal": lambda x: jc.Measurement([0.0, 1.0, 2.0, 3.0], {"a": x}, SENSOR).signals,
}


@pytest.mark.parametrize("build", BUILDERS.values(), ids=BUILDERS)
def test_what_is_built_keeps_its_numbers_when_an_array_changes(build):
    array = aligned(1.0, 2.0, 3.0, 4.0)
    built = build(array)
    before = [np.array(leaf) for leaf in jax.tree.leaves(built)]
    array[:] = 7.0
    jax.tree.map(np.testing.assert_array_equal, jax.tree.leaves(built), before)
