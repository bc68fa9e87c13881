"""Loops over few numbers as machine code. This room knows nothing of mechanics.

Why it exists: XLA runs the body of a loop operation by operation, and an operation on three numbers
costs more to start than to compute. A time step of a mechanism is some hundred such operations.
Written as one function of scalars in registers it runs at the speed of C, and several samples of a
batch run side by side in the lanes of a vector register.

The boundary is ten functions, five that tell of the program, and three for Ctrl-C:

- `while_loop(condition, body, first)` in the place of `jax.lax.while_loop`;
- `scan(turn, first, rows)` in the place of `jax.lax.scan(turn, first, rows)`: loops within its
  turns are part of the same kernel; by `TableLayout` parts of what turns leave go to tables of
  their own, each turn's to a place that is chosen beforehand, or nowhere;
- `over_rows(function, *rows)` in the place of `jax.vmap(function)(*rows)`, `through_rows` where
  rows are few and arrays are long, `one_row(function, *numbers)` and `in_one` in the place of the
  function itself, and `as_kernel`, which makes a kernel of a short one too;
- `one_by_one(function)`: a function through whose batches XLA goes sample by sample;
- `with_fast_loops(function)`: a function whose outermost loops a library has written;
- `by_columns(function, *arguments)`: backwards as many derivatives forwards as numbers move;
- `forwards_only(sentence, numbers)`: what is not differentiated backwards, and why;
- `verdict(after)`: a number in the compiled program, `explain(number)`: its sentence;
- `has_kernels()`: whether loops become kernels here at all;
- `only_kernels()`: within it a program is compiled only if its time loops are kernels, otherwise
  it raises `NoKernel`;
- `calls_lapack(after)`: whether the compiled program does, and cannot run beside another one;
- `stoppable()`: what runs within it ends at once on Ctrl-C, or by `stop()` (see `stopping`);
  `stops()`: how often that happened.

On its way a loop passes through these files:

- `while_loops`: loops as they are written; `loop`: the primitive of JAX that they become, how it
  batches, is lowered and differentiated; `tangent`: its derivative, a loop again; backwards as many
  such loops as numbers enter it that move. `program`: a loop as two programs.
- `dead_code`: dead-code elimination of what a loop carries and nobody asks for.
- `derivative_rules`: functions with derivatives of their own, backwards.
- `rows`: functions as loops of one turn, and what is no loop, and is left to XLA.
- `arithmetic`, `elementary`, `indexing`, `control`: one rule for each of JAX's primitives: what it
  becomes as LLVM code.
- `linear_systems`: large symmetric systems, factorised and solved by loops over tables.
- `writer`: the text under construction, and the registry of rules. An array is a NumPy array of
  register names, so reshaping costs nothing and a sum of three numbers is two instructions.
- `kernel`: the loop compiled by LLVM, and what it writes; `dispatch`: how XLA calls it.
- `standalone`: a function as machine code for any system, which needs neither JAX nor this process.
- `check`: one turn of a kernel on random numbers against JAX, operation by operation: a switch.
- `gpu`: the same kernels on an NVIDIA GPU, a thread a sample: off unless JAXCLEAR_GPU_KERNELS=1.
- `verdicts`: which loops became kernels, and why others did not.
- `barriers`: what XLA compiles for an accelerator, cut so that it works little out anew.

JAX's own loop is taken instead where a primitive has no rule, where the program is long, on an
accelerator unless kernels are asked for there, for derivatives of the loops of a library and of
functions of one turn that are not to be `in_one`, and with JAXCLEAR_PLAIN_LOOPS=1. Of time loops
the first two warn, once for each reason; all reasons are in the verdict. With
JAXCLEAR_CHECK_KERNELS=1 every new kernel is compared with JAX before it is used (`check`), and one
that disagrees is left to XLA with a warning: for those who write laws or rules.

What a kernel holds of its arguments: constants and the first state as one packed row of floats for
each sample (whole numbers and truth values as floats, exact to 2^53); constant arrays of more than
64 numbers stay in memory and are read by index, once for all samples that share them; and so is
written what turns of a scan leave (`tables`): an array for each of its parts, handed to XLA as it
is. An array of the state lives in registers, unless the loop's writer calls it `long`: then it
stands in memory, where turns read and change it by index, and as it was before it is nowhere.

How it is tested (tests/native): every rule by itself on awkward numbers (zeros of both signs,
infinities, nan, empty arrays, several lanes) against JAX's own evaluation; a rule without such a
case fails. Then whole loops, batches of batches, derivatives, the kernels of every joint on every
rung by the check, a wrong kernel that it must catch, another interface of XLA that must be refused.

To add a rule: write the function in the file of its subject, decorate it with `rule("name")`, and
give it a case in tests/native/test_rules.py.
"""

from jaxclear.ground.argument_errors import imported_names
from jaxclear.native.derivative_rules import by_columns as by_columns
from jaxclear.native.derivative_rules import forwards_only as forwards_only
from jaxclear.native.loop import has_kernels as has_kernels
from jaxclear.native.program import size_of as size_of
from jaxclear.native.rows import in_one as in_one
from jaxclear.native.rows import one_by_one as one_by_one
from jaxclear.native.rows import one_row as one_row
from jaxclear.native.rows import over_rows as over_rows
from jaxclear.native.rows import through_rows as through_rows
from jaxclear.native.stopping import stop as stop
from jaxclear.native.stopping import stoppable as stoppable
from jaxclear.native.stopping import stops as stops
from jaxclear.native.verdicts import NoKernel as NoKernel
from jaxclear.native.verdicts import calls_lapack as calls_lapack
from jaxclear.native.verdicts import explain as explain
from jaxclear.native.verdicts import only_kernels as only_kernels
from jaxclear.native.verdicts import verdict as verdict
from jaxclear.native.while_loops import TableLayout as TableLayout
from jaxclear.native.while_loops import as_kernel as as_kernel
from jaxclear.native.while_loops import scan as scan
from jaxclear.native.while_loops import while_loop as while_loop
from jaxclear.native.while_loops import with_fast_loops as with_fast_loops

__all__ = imported_names(globals())
