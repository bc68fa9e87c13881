"""Functions as machine code that stands by itself, called as C calls them."""

import ctypes

import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.native import object_code
from jaxclear.native.standalone import object_file, standalone
from jaxclear.native.while_loops import as_kernel


def call(function, constants, numbers):
    """What the code of a function gives, called by its address in this process."""
    made = standalone("own", function, constants, numbers)
    engine = object_code.compiled(made.text.replace("define hidden", "define"))
    address = engine.get_function_address("own")
    packed = [x for x in constants if np.size(x) <= 64]
    row = np.concatenate([np.ravel(x).astype(float) for x in [*packed, *numbers]])
    assert row.size == made.inputs
    row = np.concatenate([row, np.zeros(made.outputs + 1)])
    tables = (ctypes.c_void_p * (len(made.tables) + 1))(*(t.ctypes.data for t in made.tables))
    out = np.full(made.outputs + 1, np.nan)
    kinds = [ctypes.c_void_p] * 3
    ctypes.CFUNCTYPE(None, *kinds)(address)(row.ctypes.data, out.ctypes.data, tables)
    return out[1:]


def test_rows_within_a_function_are_gone_through_one_by_one():
    """A function of two rows that is a kernel by itself elsewhere."""

    def function(constants, numbers):
        one = lambda x: as_kernel(lambda y: jnp.sin(y) * constants[0], x)
        return [jax.vmap(one)(numbers[0])]

    rows = np.array([[0.1, 0.2], [0.3, 0.4]])
    found = call(function, [np.array(3.0)], [rows])
    np.testing.assert_allclose(found.reshape(2, 2), 3 * np.sin(rows), rtol=1e-15)


def test_a_table_is_read_by_index_and_long_arrays_may_change():
    table, many = np.linspace(0, 1, 101), np.arange(150.0)

    def function(constants, numbers):
        return [constants[0][jnp.asarray(numbers[1], int)], numbers[0] + 1]

    found = call(function, [table], [many, np.array(40.0)])
    np.testing.assert_array_equal(found, [table[40], *(many + 1)])


def test_object_files_of_other_systems_begin_as_theirs_do():
    made = standalone("own", lambda constants, numbers: [numbers[0] + 1], [], [np.array(1.0)])
    begins = {
        "x86_64-unknown-linux-gnu": (b"\x7fELF", "x86-64"),
        "aarch64-unknown-linux-gnu": (b"\x7fELF", "generic"),
        "arm64-apple-macosx11.0": (b"\xcf\xfa\xed\xfe", "apple-m1"),
        "x86_64-w64-windows-gnu": (b"\x64\x86", "x86-64"),
    }
    for triple, (mark, cpu) in begins.items():
        assert object_file([made], triple, cpu).startswith(mark)
