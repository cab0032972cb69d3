"""What all tests share: where the data lies that the project may not ship, and settings for property tests."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).parents[1]
# Helpers of the tests are imported as `support.NAME`.
sys.path.insert(0, str(ROOT / "tests"))

# A shell begins what it runs in the background with SIGINT ignored, and children would inherit that: those that are
# stopped by it here would not stop.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# No deadline: these machines are noisy, and kernels compile on their first call.
settings.register_profile("default", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("default")


@pytest.fixture(scope="session")
def beacon_data() -> Path:
    """Return the folder of the real beacon recordings (for academic use only, beside the project)."""
    folder = Path(os.environ.get("HELIOGRAPH_BEACON_DATA", ROOT.parent / "shared" / "data" / "beacon"))
    if not folder.is_dir():
        pytest.skip("the beacon recordings of Wang et al. 2022 are not here (academic use only, not shipped)")
    return folder


@pytest.fixture(scope="session")
def scene_data() -> Path:
    """Return the folder of the real scenes without a beacon."""
    folder = Path(os.environ.get("HELIOGRAPH_SCENE_DATA", ROOT.parent / "shared" / "data" / "scenes"))
    if not folder.is_dir():
        pytest.skip("the recorded scenes are not here")
    return folder
