"""The text of a kernel of one lane as that of one thread among many: on a GPU each takes a sample.

Threads next to each other read numbers next to each other: entry k of an array of sample t stands
at k * samples + t, of packed rows, of arrays in memory and of tables. What all samples share is
read where it is, and what a kernel keeps for itself stays its thread's. Which pointers step over
samples follows from where they come from, line by line; what else is done with a pointer is
refused (`Unsupported`).

The flag that stops kernels is not there on a device: a kernel of many threads ends by itself, soon.

Compiled for the processor and gone through thread by thread, the same text is what tests compare
with the kernels that they stand in for (tests/native/test_gpu.py).
"""

import re
from typing import NamedTuple

from jaxclear.native import kernel as kernels
from jaxclear.native.program import (
    Program,
    arrays_in_memory,
    avals_of,
    floats_in,
    in_memory,
    packed_state,
)
from jaxclear.native.writer import STOP_FLAG, Unsupported

# Threads that a block has: few, as each wants all the registers that it can have.
BLOCK = 64
# More pointers than a kernel's arguments hold: 4096 bytes, on every device.
MOST_ARRAYS = 500

_ENTRY = re.compile(r"  (%\S+) = getelementptr (\w+), ptr ([%@]\S+), i64 (\S+)")
_SLOT = re.compile(r"  (%\S+) = getelementptr ptr, ptr %big, i64 (\d+)")
_START = re.compile(r"  (%\S+) = load ptr, ptr (%\S+)")
_ALLOCATION = re.compile(r"  (%\S+) = alloca .*")
_USE = re.compile(r"  (?:%\S+ = load \w+|store \w+ \S+), ptr ([%@][^\s,]+)(?:, [^%]*)?")
_CALL = re.compile(r"  call void @NAME\.\w+\((ptr [%@]\S+(?:, ptr [%@]\S+)*)\)")
_COPY = re.compile(
    r"  call void @llvm\.memcpy\.p0\.p0\.i64\(ptr (%\S+), ptr (%\S+), i64 (\S+), i1 false\)"
)
_SPOIL = re.compile(r"  call void @NAME\.spoil\(ptr (%\S+), i64 (\d+)\)")
_FLAG = re.compile(rf"  (%\S+) = load volatile i64, ptr {STOP_FLAG}")
_HEAD = "define internal void @NAME.loop("

# Numbers that stand apart by so many, copied, and made nan.
ARRAY_FUNCTIONS = [
    kernels.over_numbers(
        "copy(ptr %to, i64 %far, ptr %from, i64 %wide, i64 %count)",
        "%count",
        """  %there = mul i64 %k, %wide
  %source = getelementptr double, ptr %from, i64 %there
  %number = load double, ptr %source
  %here = mul i64 %k, %far
  %target = getelementptr double, ptr %to, i64 %here
  store double %number, ptr %target""",
    ),
    kernels.over_numbers(
        "spoil.apart(ptr %array, i64 %numbers, i64 %far)",
        "%numbers",
        """  %here = mul i64 %k, %far
  %place = getelementptr double, ptr %array, i64 %here
  store double 0x7FF8000000000000, ptr %place""",
    ),
]

# The thread's number among all, and its samples' pointers.
_ON_DEVICE = """declare i32 @llvm.nvvm.read.ptx.sreg.tid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
define ptx_kernel void @NAME({parameters}) {{
entry:
  %in.block = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
  %block = call i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
  %threads = call i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
  %before = mul i32 %block, %threads
  %number = add i32 %before, %in.block
  %thread = zext i32 %number to i64
  %beyond = icmp sge i64 %thread, %samples
  br i1 %beyond, label %done, label %within
done:
  ret void
within:
{pointers}
  call void @NAME.loop({arguments})
  ret void
}}
!nvvm.annotations = !{{!999999}}
!999999 = !{{ptr @NAME, !"maxntidx", i32 {block}}}"""
_ON_HOST = """define void @NAME(i64 %thread, {parameters}) {{
entry:
{pointers}
  call void @NAME.loop({arguments})
  ret void
}}"""


class Arrays(NamedTuple):
    """What a kernel is handed: numbers of its packed rows, in and out, and of each of its arrays,
    for a sample: those that are read (0: it is the same for all samples), and behind them those
    that are written."""

    width: int
    height: int
    read: list[int]
    written: list[int]


def arrays_of(program: Program) -> Arrays:
    """What the kernel of a loop is handed."""
    constants, state = avals_of(program)
    array_shapes = list(enumerate(zip([*constants, *state], in_memory(program), strict=True)))
    read = [0 if i in program.shared else floats_in([a]) for i, (a, long) in array_shapes if long]
    return Arrays(
        floats_in([a for _, (a, long) in array_shapes if not long]),
        floats_in(packed_state(program)),
        read,
        [*(floats_in([a]) for a in arrays_in_memory(program)), *kernels.sizes_of_tables(program)],
    )


def text_of(program: Program, checked: bool = False, on_host: bool = False) -> str:
    """LLVM code of a loop's kernel `@NAME(samples, in, out, arrays...)` for one GPU thread.

    Args:
        program: the loop, its condition and body as JAX programs.
        checked: whether it takes one turn only.
        on_host: whether it is for the processor, with the thread's number as first argument.

    Raises:
        Unsupported: a primitive has no rule, or there are too many arrays.
    """
    arrays = arrays_of(program)
    count = len(arrays.read) + len(arrays.written)
    if count > MOST_ARRAYS:
        raise Unsupported(f"{count} arrays in memory, on a GPU")
    steps = [size > 0 for size in arrays.read] + [True] * len(arrays.written)
    written = kernels.text_of(program, 1, checked)
    before, head, rest = written.partition(_HEAD)
    # As metadata stands behind the loop's functions.
    body, end, behind = rest.partition("\n}")
    _, _, lines = body.partition(" {\nentry:")
    params = ", ".join(f"ptr noalias %array.{k}" for k in range(count))
    named = f"ptr noalias %in, ptr noalias %out, i64 %samples{', ' if params else ''}{params}"
    thread = "\n".join(_thread(lines.split("\n"), steps))
    loop = f"{head}{named}) alwaysinline {{\nentry:{thread}{end}"
    return "\n".join([before, *ARRAY_FUNCTIONS, loop, behind, _entry_function(steps, on_host)])


def _thread(lines: list[str], steps: list[bool]) -> list[str]:
    """The loop's lines, what is the thread's own found at its places; `steps`: whether the entries
    of each array stand apart by the number of samples."""
    strided, slots, out = _StridedPointers({"%in": True, "%out": True}), {}, []
    far = lambda register: "%samples" if strided[register] else "1"
    try:
        for line in lines:
            if match := _SLOT.fullmatch(line):
                slots[match[1]] = int(match[2])
            elif match := _ENTRY.fullmatch(line):
                name, kind, start, index = match.groups()
                strided[name] = strided[start]
                if strided[start]:
                    if kind != "double":
                        raise KeyError(line.strip())
                    out.append(f"  {name}.ahead = mul i64 {index}, %samples")
                    index = f"{name}.ahead"
                out.append(f"  {name} = getelementptr {kind}, ptr {start}, i64 {index}")
            elif match := _START.fullmatch(line):
                slot = slots[match[2]]
                strided[match[1]] = steps[slot]
                out.append(f"  {match[1]} = getelementptr i8, ptr %array.{slot}, i64 0")
            elif match := _COPY.fullmatch(line):
                to, start, size = match[1], match[2], int(match[3])
                copied = f"ptr {to}, i64 {far(to)}, ptr {start}, i64 {far(start)}, i64 {size // 8}"
                out.append(f"  call void @NAME.copy({copied})")
            elif match := _SPOIL.fullmatch(line):
                copied = f"ptr {match[1]}, i64 {match[2]}, i64 {far(match[1])}"
                out.append(f"  call void @NAME.spoil.apart({copied})")
            elif match := _FLAG.fullmatch(line):
                out.append(f"  {match[1]} = add i64 0, 0")
            else:
                _note_pointer(line, strided)
                out.append(line)
    except (KeyError, ValueError) as unknown:
        raise Unsupported(f"a use of memory that is not known on a GPU: {unknown}") from unknown
    return out


class _StridedPointers(dict):
    """By register, whether what stands behind its place is as far as there are samples, or next,
    as constants of the kernel are."""

    def __missing__(self, register):
        if register.startswith("@"):
            return False
        raise KeyError(register)


def _note_pointer(line: str, strided: _StridedPointers) -> None:
    """Raises `KeyError` where a line does with a pointer what is not known here, and notes a
    pointer to what the thread keeps for itself."""
    if match := _ALLOCATION.fullmatch(line):
        strided[match[1]] = False
    elif match := _USE.fullmatch(line):
        # Known, and one number.
        strided[match[1]]
    elif match := _CALL.fullmatch(line):
        # A function of the kernel's own counts on numbers next to each other.
        if any(strided[each.split()[1]] for each in match[1].split(", ")):
            raise KeyError(line.strip())
    elif re.search(r"\bptr\b", line):
        raise KeyError(line.strip())


def _entry_function(steps: list[bool], on_host: bool) -> str:
    """The function that a thread enters."""
    space = "ptr" if on_host else "ptr addrspace(1)"
    # The threads' own begin at their number, what they share at its beginning.
    strides = {"in": True, "out": True} | {f"array.{k}": strides for k, strides in enumerate(steps)}
    pointers = []
    for name, first in strides.items():
        cast = (
            f"getelementptr i8, ptr %{name}.given, i64 0"
            if on_host
            else f"addrspacecast ptr addrspace(1) %{name}.given to ptr"
        )
        pointers.append(f"  %{name}.begin = {cast}")
        ahead = "%thread" if first else "0"
        pointers.append(f"  %{name} = getelementptr double, ptr %{name}.begin, i64 {ahead}")
    arrays = [f"ptr %array.{k}" for k in range(len(steps))]
    return (_ON_HOST if on_host else _ON_DEVICE).format(
        parameters=", ".join(["i64 %samples", *(f"{space} noalias %{n}.given" for n in strides)]),
        pointers="\n".join(pointers),
        arguments=", ".join(["ptr %in", "ptr %out", "i64 %samples", *arrays]),
        block=BLOCK,
    )
