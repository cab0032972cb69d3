"""One way to compile: cached on disk, without the interpreter's lock, types kept for the checker.

Neither `fastmath` nor `parallel`: results must be the same on every run.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

_F = TypeVar("_F", bound=Callable[..., object])


def kernel(function: _F) -> _F:
    """Return the function, compiled at its first call and cached beside its file."""
    return cast("_F", numba.njit(cache=True, nogil=True)(function))


def inlined(function: _F) -> _F:
    """Return the function for use within kernels of the same file, written out where it is called.

    Calls hide a loop's body from the compiler, which then does not vectorise it.
    """
    return cast("_F", numba.njit(nogil=True, inline="always")(function))
