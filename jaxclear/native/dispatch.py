"""The one function that XLA knows: it looks a kernel up by its number and enters it.

XLA keeps a registered function for ever. Kernels go with their programs, so they are not
registered: a custom call carries a kernel's number, which its text decides, and a table gives the
address that this number has in this process. A number that is not in the table ends the run with an
error of XLA.
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
  %place = phi i64 [ %first, %execute ], [ %next, %further ]
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
  %address_place = getelementptr i64, ptr %pair, i64 1
  %address = load atomic i64, ptr %address_place acquire, align 8
  %known = icmp ne i64 %address, 0
  br i1 %known, label %call, label %missing
call:
  %kernel = inttoptr i64 %address to ptr
  %error = tail call ptr %kernel(ptr %frame)
  ret ptr %error
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
    place = _place(number)
    # The number last: a kernel that runs in another thread may be looking here.
    TABLE[2 * place + 1] = address
    TABLE[2 * place] = number


def remove(number: int, address: int) -> None:
    """The number stands for no kernel any more, if it stood for the one at this address."""
    place = _place(number)
    if (TABLE[2 * place], TABLE[2 * place + 1]) == (number, address):
        TABLE[2 * place + 1] = 0


def size() -> int:
    """Kernels in the table."""
    return sum(address != 0 for address in TABLE[1::2])
