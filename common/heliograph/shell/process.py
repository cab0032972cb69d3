"""A process's manners: it stops in order on the first signal, at once on the second, and never outlives its parent.

One that lies on the way from a light to its reader wakes in time (`wake_promptly`).
"""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import sys
import time
from pathlib import Path
from queue import Empty, SimpleQueue
from types import FrameType
from typing import Final

# Set by a supervisor for its children: end with me.
PARENT_VARIABLE: Final = "HELIOGRAPH_PARENT"
_PR_SET_PDEATHSIG: Final = 1  # linux/prctl.h
_PR_SET_TIMERSLACK: Final = 29
# How late a sleeper may be woken, so that its waking may be joined with others': 50 us unless it is asked for less.
_TIMER_SLACK_NS: Final = 1
# How late a stop may be seen by a process that naps. A sleep takes 28 us of the processor, an event 43, and wakes 60 us
# later (1 ms, shared x86).
_NAP_S: Final = 0.02
EXIT_FORCED: Final = 130  # the shell's convention for an end by SIGINT


class Stop:
    """Becomes true on SIGINT or SIGTERM; a second signal ends the process there and then.

    A signal's handler runs in the main thread, wherever that is: a `threading.Event` would be set while the same thread
    holds its lock, now and then, and never come back. A `SimpleQueue` may be put to from anywhere.
    """

    def __init__(self) -> None:
        self._is_set = False
        self._wake: SimpleQueue[None] = SimpleQueue()

    def install(self) -> None:
        """Take over SIGINT and SIGTERM; main thread only."""
        signal.signal(signal.SIGINT, self._on_signal)
        signal.signal(signal.SIGTERM, self._on_signal)

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        if self._is_set:
            os._exit(EXIT_FORCED)
        self.set()

    def set(self) -> None:
        """Stop from within."""
        self._is_set = True
        self._wake.put(None)

    def __bool__(self) -> bool:
        return self._is_set

    def wait(self, seconds: float) -> bool:
        """Wait for the stop, at most that long; return whether it came, of which a short wait knows only at its end."""
        if self._is_set:
            return True
        if seconds <= _NAP_S:
            time.sleep(seconds)
            return self._is_set
        try:
            self._wake.get(timeout=seconds)
        except Empty:
            return self._is_set
        self._wake.put(None)  # for whoever else waits
        return True


def keep_kernels() -> None:
    """Let numba keep compiled kernels inside the virtual environment, where the scripts keep them too.

    Beside the sources, numba's own choice, a service would compile for half a minute what the scripts have compiled.
    """
    if sys.prefix != sys.base_prefix:
        os.environ.setdefault("NUMBA_CACHE_DIR", str(Path(sys.prefix) / "numba-cache"))


def wake_promptly() -> None:
    """Ask the kernel to wake this process, and its threads to come, when it is time (Linux; elsewhere nothing).

    A source that sleeps until a batch is due sends it .06 ms after that, .12 otherwise (medians).
    """
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_TIMERSLACK, _TIMER_SLACK_NS, 0, 0, 0)


def keep_out_of_collections() -> None:
    """Exempt all that is there by now, once a process is warm, from the search for garbage.

    Compiled kernels come with several hundred thousand objects, which live as long as the process; to look at them all
    takes a tenth of a second, for which nothing would be decoded.
    """
    gc.collect()
    gc.freeze()


def end_with_parent() -> None:
    """Ask the kernel for SIGTERM when the parent ends, where a supervisor wants it (Linux only)."""
    if not os.environ.get(PARENT_VARIABLE) or not sys.platform.startswith("linux"):
        return
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() == 1:  # the parent ended before the call
        os._exit(EXIT_FORCED)
