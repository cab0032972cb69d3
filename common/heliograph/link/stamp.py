"""A number that changes with the sources that a compiled kernel is made of.

Numba's cache looks at the source of a function's own file alone: a kernel that calls kernels of other files would go on
running their old code after they changed (after an upgrade, say). The cache's key does contain what a function closes
over, so an entry kernel is built by a function of this stamp and mentions it; what it calls is not cached on its own.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from types import ModuleType


def stamp(*modules: ModuleType) -> int:
    """Return a number, at least 0, made of the modules' source files; 0 where there are none to read."""
    digest = hashlib.sha256()
    for module in modules:
        if module.__file__ is None:
            return 0
        try:
            digest.update(Path(module.__file__).read_bytes())
        except OSError:
            return 0
    return int.from_bytes(digest.digest()[:7], "little")
