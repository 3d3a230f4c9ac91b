"""Fixtures shared by all tests."""

import os
import sys
from pathlib import Path

import pytest

# Tests share inputs with each other and with benchmarks/. Last on the path: an installed touchnet comes first.
sys.path.append(str(Path(__file__).resolve().parents[1]))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real data: meshes, touches, cases. TOUCHNET_SHARED, or ../shared beside the repository."""
    given = os.environ.get("TOUCHNET_SHARED")
    path = Path(given) if given else Path(__file__).resolve().parents[2] / "shared"
    if not path.is_dir():
        pytest.skip(f"real data not found: no folder {path.name!r} beside the repository, TOUCHNET_SHARED not set")
    return path
