"""How the innermost functions are compiled: without the counting of references.

Each array that a compiled function is called with costs it two atomic additions, some 10 ns, and keeps it from being
inlined; a pixel's whole law takes about 50 ns. A leaf makes no arrays and keeps none, so there is nothing to count.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def leaf(function: F) -> F:
    """Return the function, compiled; it makes no arrays."""
    # Numba's own word for it, without which its stubs are written.
    return cast("F", numba.njit(nogil=True, _nrt=False)(function))  # type: ignore[call-overload]
