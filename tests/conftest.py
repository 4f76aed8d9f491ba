"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the public recordings; a test that needs it is skipped where it is missing.

    It is `CDM_PIN_DATA`, else `data` in the repository, else `shared/data` beside it. With `CDM_PIN_REQUIRE_DATA=1` a
    missing folder fails the test.
    """
    named = os.environ.get("CDM_PIN_DATA")
    for folder in [Path(named)] if named else [ROOT / "data", ROOT.parent / "shared" / "data"]:
        if (folder / "dvrk_psm_wpi").is_dir():
            return folder
    message = "the public recordings are missing: run scripts/get_data.py, or set CDM_PIN_DATA to their folder"
    if os.environ.get("CDM_PIN_REQUIRE_DATA") == "1":
        pytest.fail(message)
    pytest.skip(message)
