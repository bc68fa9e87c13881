"""A function of few numbers as machine code that needs neither JAX nor this process: an object file
for any processor and system, which a linker of theirs takes.

The function is called as `name(in, out, tables)`: one row of floats for its arguments, one for what
it gives (behind the number of its turns, which is 1), whole numbers and truth values as floats; and
the places of long arrays that never change.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.native import kernel, stopping
from jaxclear.native.program import Program, avals_of, in_memory
from jaxclear.native.while_loops import open_constants
from jaxclear.native.writer import LONGEST_IN_REGISTERS, Unsupported


class Standalone(NamedTuple):
    """A function as LLVM code: its `name`, `text`, how many numbers its arguments and what it gives
    have, and the long arrays that it reads."""

    name: str
    text: str
    inputs: int
    outputs: int
    tables: list[np.ndarray]


def standalone(
    name: str, function: Callable, constants: Sequence[Any], numbers: Sequence[Any]
) -> Standalone:
    """A function of few numbers as LLVM code that needs neither JAX nor this process.

    Args:
        name: of the function in the object file.
        function: of two lists of arrays, constants and numbers; gives a list of arrays.
        constants: arrays of which long ones become tables.
        numbers: arrays that vary from call to call; they go into registers.

    Raises:
        Unsupported: a primitive has no rule.
    """
    constants, numbers = ([jnp.asarray(x) for x in arguments] for arguments in (constants, numbers))
    # What may change is in registers, a few numbers at a time.
    pieces = [
        np.array_split(np.arange(x.size), max(1, -(-x.size // LONGEST_IN_REGISTERS)))
        for x in numbers
    ]
    cut = [
        jnp.ravel(x)[part] if len(parts) > 1 else x
        for x, parts in zip(numbers, pieces, strict=True)
        for part in parts
    ]
    arguments = [*constants, *cut]

    def whole(*values: Any) -> list:
        first, rest = values[: len(constants)], iter(values[len(constants) :])
        joined = [
            jnp.concatenate([next(rest) for _ in parts]).reshape(x.shape)
            if len(parts) > 1
            else next(rest)
            for x, parts in zip(numbers, pieces, strict=True)
        ]
        return [jnp.asarray(x) for x in function(list(first), joined)]

    shapes = jax.eval_shape(whole, *arguments)
    zeros = [jnp.zeros((), int), *(jnp.zeros(x.shape, x.dtype) for x in shapes)]

    def body(*values: Any) -> list:
        return [values[len(arguments)] + 1, *whole(*values[: len(arguments)])]

    tests, _ = open_constants(jax.make_jaxpr(lambda turns, *_: turns < 1)(*zeros))
    turns, captured = open_constants(jax.make_jaxpr(body)(*arguments, *zeros))
    program = Program(
        tests, turns, 0, len(captured) + len(arguments), single_turn=True, vmapped=True
    )
    text = kernel.text_of(program, 1)
    constant_avals, state = avals_of(program)
    is_long = in_memory(program)[: len(constant_avals)]
    tables = [np.asarray(x) for x, one in zip([*captured, *arguments], is_long, strict=True) if one]
    if any(x.size and not one for x, one in zip(captured, is_long, strict=False)):
        raise Unsupported("a long array that is no table")
    size = sum(x.size for x, one in zip(constant_avals, is_long, strict=True) if not one)
    head = f"@{stopping.SYMBOL} = internal global i64 0\n"
    text = text.replace("define internal void @NAME.loop", f"define hidden void @{name}")
    text = text.replace("@NAME", f"@{name}").replace(f"@{name}.loop", f"@{name}")
    return Standalone(name, head + text, size, sum(x.size for x in state) - 1, tables)


def object_file(functions: Sequence[Standalone], triple: str, cpu: str) -> bytes:
    """Machine code of functions, as the bytes of an object file.

    Args:
        functions: LLVM code of each (`standalone`).
        triple: LLVM's name of the target, such as "x86_64-unknown-linux-gnu".
        cpu: LLVM's name of the processor.
    """
    import llvmlite.binding as llvm

    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple(triple)
    machine = target.create_target_machine(
        opt=3, cpu=cpu, features="", reloc="pic", codemodel="default", jit=False
    )
    whole = None
    for one in functions:
        module = llvm.parse_assembly(one.text)
        module.triple, module.data_layout = triple, str(machine.target_data)
        if whole is None:
            whole = module
        else:
            whole.link_in(module)
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    passes = llvm.create_pass_builder(machine, options)
    passes.getModulePassManager().run(whole, passes)
    return machine.emit_object(whole)
