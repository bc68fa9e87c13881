"""The one function that XLA knows: it looks a kernel up by its number and enters it.

XLA keeps a registered function for ever. Kernels go with their programs, so they are not
registered: a custom call carries a kernel's number, which its text decides, and a table gives the
address that this number has in this process. A number that is not in the table ends the run with an
error of XLA. Calls under way are counted: the memory of a kernel is freed when there are none.
"""

import ctypes
import functools
from typing import Any

import jax

from jaxclear.native import call_frame, machine

TARGET = "jaxclear_loop"
# Entries of the table, a power of two; open addressing wants it half empty.
PLACES = 1 << 14
# Pairs (number, address); a number stays when its kernel has gone, with address 0, until another
# kernel takes its place.
TABLE = (ctypes.c_int64 * (2 * PLACES))()
# Calls under way of the kernels at each place.
CALLS = (ctypes.c_int64 * PLACES)()
# The number of a place while another kernel takes it.
CHANGING = -1
GONE = b"jaxclear: the kernel of this program has been dropped; compile the program again."
# Code of an internal error in XLA's foreign function interface.
INTERNAL = 13

FUNCTION = """
@message = internal constant [{length} x i8] c"{message}\\00"
define ptr @{name}(ptr %frame) {{
entry:
  %extension_place = getelementptr i8, ptr %frame, i64 8
  %extension = load ptr, ptr %extension_place
  %plain = icmp eq ptr %extension, null
  br i1 %plain, label %execute, label %describe
describe:
  %metadata_place = getelementptr i8, ptr %extension, i64 24
  %metadata = load ptr, ptr %metadata_place
  %major = getelementptr i8, ptr %metadata, i64 24
  store i32 {major}, ptr %major
  %minor = getelementptr i8, ptr %metadata, i64 28
  store i32 {minor}, ptr %minor
  %traits = getelementptr i8, ptr %metadata, i64 32
  store i32 0, ptr %traits
  %state = getelementptr i8, ptr %metadata, i64 40
  store i64 0, ptr %state
  ret ptr null
execute:
  %attributes_place = getelementptr i8, ptr %frame, i64 160
  %attributes = load ptr, ptr %attributes_place
  %scalar = load ptr, ptr %attributes
  %number_place = getelementptr i8, ptr %scalar, i64 8
  %number_pointer = load ptr, ptr %number_place
  %number = load i64, ptr %number_pointer
  %table = inttoptr i64 {table} to ptr
  %first = and i64 %number, {mask}
  br label %probe
probe:
  %place = phi i64 [ %first, %execute ], [ %next, %further ], [ %first, %probe_anew ]
  %index = mul i64 %place, 2
  %pair = getelementptr i64, ptr %table, i64 %index
  %found = load atomic i64, ptr %pair acquire, align 8
  %hit = icmp eq i64 %found, %number
  br i1 %hit, label %enter, label %look
look:
  %empty = icmp eq i64 %found, 0
  br i1 %empty, label %missing, label %further
further:
  %following = add i64 %place, 1
  %next = and i64 %following, {mask}
  br label %probe
enter:
  %calls = inttoptr i64 {calls} to ptr
  %count = getelementptr i64, ptr %calls, i64 %place
  %before = atomicrmw add ptr %count, i64 1 seq_cst
  %address_place = getelementptr i64, ptr %pair, i64 1
  %address = load atomic i64, ptr %address_place seq_cst, align 8
  %still = load atomic i64, ptr %pair seq_cst, align 8
  %own = icmp eq i64 %still, %number
  %there = icmp ne i64 %address, 0
  %known = and i1 %own, %there
  br i1 %known, label %call, label %leave
call:
  %kernel = inttoptr i64 %address to ptr
  %error = call ptr %kernel(ptr %frame)
  %during = atomicrmw sub ptr %count, i64 1 seq_cst
  ret ptr %error
leave:
  %after = atomicrmw sub ptr %count, i64 1 seq_cst
  br i1 %own, label %missing, label %probe_anew
probe_anew:
  br label %probe
missing:
  %given = alloca {{ i64, ptr, ptr, i32 }}
  store {{ i64, ptr, ptr, i32 }} {{ i64 28, ptr null, ptr @message, i32 {internal} }}, ptr %given
  %interface_place = getelementptr i8, ptr %frame, i64 16
  %interface = load ptr, ptr %interface_place
  %create_place = getelementptr i8, ptr %interface, i64 48
  %create = load ptr, ptr %create_place
  %made = call ptr %create(ptr %given)
  ret ptr %made
}}
define void @{name}.enter(ptr %pair, i64 %number, i64 %address) {{
entry:
  %address_place = getelementptr i64, ptr %pair, i64 1
  store atomic i64 {changing}, ptr %pair seq_cst, align 8
  store atomic i64 %address, ptr %address_place seq_cst, align 8
  store atomic i64 %number, ptr %pair seq_cst, align 8
  ret void
}}
define i64 @{name}.leave(ptr %pair, ptr %count) {{
entry:
  %address_place = getelementptr i64, ptr %pair, i64 1
  %address = atomicrmw xchg ptr %address_place, i64 0 seq_cst
  %calls = load atomic i64, ptr %count seq_cst, align 8
  ret i64 %calls
}}
"""


@functools.cache
def known_to_xla() -> Any:
    """Makes the function known to XLA, once; gives the engine that holds it."""
    major, minor = call_frame.interface_version()
    text = FUNCTION.format(
        name=TARGET,
        major=major,
        minor=minor,
        table=ctypes.addressof(TABLE),
        calls=ctypes.addressof(CALLS),
        changing=CHANGING,
        mask=PLACES - 1,
        length=len(GONE) + 1,
        message=GONE.decode(),
        internal=INTERNAL,
    )
    engine = machine.compiled(text)
    capsule = ctypes.pythonapi.PyCapsule_New
    capsule.restype, capsule.argtypes = (
        ctypes.py_object,
        [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p],
    )
    address = engine.get_function_address(TARGET)
    jax.ffi.register_ffi_target(TARGET, capsule(address, None, None), platform="cpu", api_version=1)
    return engine


def _place(number: int) -> int:
    """Where a number stands in the table, or else the first place that is free for it."""
    place, free = number % PLACES, None
    for _ in range(PLACES):
        found, address = TABLE[2 * place], TABLE[2 * place + 1]
        if found == number:
            return place
        if free is None and address == 0:
            free = place
        if found == 0:
            break
        place = (place + 1) % PLACES
    if free is None:
        raise MemoryError(f"jaxclear keeps {PLACES} kernels at once, and these are in use.")
    return free


def enter(number: int, address: int) -> None:
    """From now on this number (positive, 63 bits) stands for the kernel at an address."""
    # The number last, and nobody's before: a call in another thread may be looking here.
    _ordered("enter", None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)(
        _pair(_place(number)), number, address
    )


def remove(number: int, address: int) -> int:
    """The number stands for no kernel any more, if it stood for the one at this address. Gives the
    place at which calls of it that are under way are counted."""
    place = _place(number)
    if (TABLE[2 * place], TABLE[2 * place + 1]) == (number, address):
        _ordered("leave", ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p)(
            _pair(place), ctypes.addressof(CALLS) + 8 * place
        )
    return place


def in_use(place: int) -> bool:
    """Whether a kernel is being called at a place of the table."""
    return CALLS[place] > 0


def _pair(place: int) -> int:
    return ctypes.addressof(TABLE) + 16 * place


def _ordered(what: str, *types: Any) -> Any:
    """A function of machine code that changes the table in an order that other threads see too."""
    return ctypes.CFUNCTYPE(*types)(known_to_xla().get_function_address(f"{TARGET}.{what}"))


def size() -> int:
    """Kernels in the table."""
    return sum(address != 0 for address in TABLE[1::2])
