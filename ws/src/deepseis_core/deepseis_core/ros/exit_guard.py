"""An end of the process that needs neither the interpreter nor DDS to let go."""

from __future__ import annotations

import ctypes
import math
import time

_SIGEV_THREAD = 2


class _SignalEvent(ctypes.Structure):
    """``struct sigevent`` of Linux, with room for what it holds besides."""

    _fields_ = (
        ("value", ctypes.c_int),
        ("_padding", ctypes.c_int),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("attributes", ctypes.c_void_p),
        ("_room", ctypes.c_byte * 64),
    )


class _TimerSpan(ctypes.Structure):
    """``struct itimerspec``: interval and first expiry [s], [ns]."""

    _fields_ = tuple(
        (name, ctypes.c_long) for name in ("every_s", "every_ns", "first_s", "first_ns")
    )


def leave_within(seconds: float, status: int) -> None:
    """End this process with ``status`` if it has not ended by itself in time.

    Fast DDS may lock itself up while a process leaves (its issue 6502: a peer's lease is checked
    in the moment in which another peer goes), and rclpy holds the interpreter's lock then, so that
    no thread and no signal handler of Python runs. A timer of the C library calls ``_exit``.

    Parameters
    ----------
    seconds : float
        Longer than an orderly end takes [s].
    status : int
        What the process has come to.

    Raises
    ------
    OSError
        There is no timer to be had.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    event = _SignalEvent(
        value=status,
        notify=_SIGEV_THREAD,
        function=ctypes.cast(libc._exit, ctypes.c_void_p).value,
    )
    timer = ctypes.c_void_p()
    if libc.timer_create(time.CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)):
        raise OSError(ctypes.get_errno(), "timer_create")
    fraction, whole = math.modf(seconds)
    span = _TimerSpan(first_s=int(whole), first_ns=round(fraction * 1e9))
    if libc.timer_settime(timer, 0, ctypes.byref(span), None):
        raise OSError(ctypes.get_errno(), "timer_settime")
