"""Ctrl-C while kernels run: one flag that all of them read at every turn of their loop.

Python's own answer to Ctrl-C waits until machine code returns, and a run is machine code from its
start to its end. So, while `stoppable` holds, the signal is also written to a socket, a thread that
listens there raises the flag, the kernels end at their next turn with nan for their numbers, the
program comes to its end within moments, and Python raises KeyboardInterrupt where it waited.

The flag is one for the process: whatever else of this package runs then, in other threads, stops
too, and raises KeyboardInterrupt as well. A run outside of `stoppable` (a function of this package
in a program that the user compiled) may only see nan, never a number that looks like an answer.
"""

import ctypes
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

FLAG = (ctypes.c_int64 * 1)(0)
# What runs now, by its token, and how often runs were stopped. Changed by single statements without
# a call, within which Python does not look for signals.
_ACTIVE: dict[object, bool] = {}
_STOPS = [0]
# [s] between looks at whether other runs have come to their end after a stop.
PATIENCE = 1e-3
# Longest wait for the listener [s]: it needs microseconds.
LONGEST_WAIT = 1.0


# The flag, as machine code that is kept between processes knows it.
SYMBOL = "jaxclear_stop_flag"


def place_flag() -> None:
    """Tells LLVM where the flag is in this process."""
    import llvmlite.binding as llvm

    llvm.add_symbol(SYMBOL, ctypes.addressof(FLAG))


def stop() -> None:
    """Ends all kernels that run within `stoppable`."""
    if _ACTIVE:
        _STOPS[0] += 1
        FLAG[0] = 1


def stops() -> int:
    """How often runs were stopped. What was computed while this rose may hold nan."""
    return _STOPS[0]


@contextmanager
def stoppable() -> Iterator[None]:
    """Ctrl-C ends what runs within, at once; KeyboardInterrupt where it was stopped."""
    while FLAG[0] and _ACTIVE:
        time.sleep(PATIENCE)
    token = object()
    stops = _STOPS[0]
    listener = _Listener.start()
    FLAG[0] = FLAG[0] if _ACTIVE else 0
    _ACTIVE[token] = True
    try:
        yield
        if _STOPS[0] != stops:
            raise KeyboardInterrupt("the run was stopped")
    except KeyboardInterrupt:
        stop()
        if listener is not None:
            listener.catch_up()
        raise
    finally:
        del _ACTIVE[token]
        if not _ACTIVE:
            FLAG[0] = 0
        if listener is not None:
            listener.end()


# The one there is, if any.
_LISTENERS: list["_Listener"] = []


class _Listener:
    """The thread that hears signals while the main thread is in machine code."""

    def __init__(self):
        self._hears, self._sender = socket.socketpair()
        self._sender.setblocking(False)
        self._caught_up = threading.Event()
        self._before = -1
        threading.Thread(target=self._listen, name="jaxclear Ctrl-C", daemon=True).start()

    @staticmethod
    def start() -> "_Listener | None":
        """Listens from now on; None where Ctrl-C would not raise KeyboardInterrupt in this thread,
        or somebody listens already.
        """
        if threading.current_thread() is not threading.main_thread():
            return None
        if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
            return None
        if not _LISTENERS:
            _LISTENERS.append(_Listener())
        listener = _LISTENERS[0]
        before = signal.set_wakeup_fd(listener._sender.fileno(), warn_on_full_buffer=False)
        if before == listener._sender.fileno():
            return None
        listener._before = before
        return listener

    def end(self) -> None:
        """Whoever listened before listens again."""
        signal.set_wakeup_fd(self._before)

    def catch_up(self) -> None:
        """Returns when all signals up to now have been heard."""
        self._caught_up.clear()
        self._sender.send(b"\0")
        self._caught_up.wait(LONGEST_WAIT)

    def _listen(self) -> None:
        while True:
            for number in self._hears.recv(64):
                if number == 0:
                    self._caught_up.set()
                    continue
                if number == signal.SIGINT:
                    stop()
                self._pass_on(number)

    def _pass_on(self, number: int) -> None:
        """To whoever listened before: an event loop, say."""
        if self._before >= 0:
            with suppress(OSError):
                os.write(self._before, bytes([number]))
