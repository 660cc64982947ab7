"""Scenes that several rooms are tested on; shape checking of every annotated function while tests run."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from jaxtyping import install_import_hook

#: Rooms whose annotated shapes and dtypes are checked while tests run; not the kernels, which numba must pickle.
CHECKED = (
    "scene",
    "geometry",
    "semantics",
    "mapping",
    "mapper",
    "topology",
    "accumulation",
    "contract",
    "exchange",
    "export",
    "datasets",
    *(f"studies.{name}" for name in ("baselines", "case_files", "cases", "pixels", "references", "terrain")),
)
install_import_hook([f"excavatwin.{room}" for room in CHECKED], "type_checks.checked")

os.environ.setdefault("NUMBA_THREADING_LAYER", "workqueue")

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real photos and references; the test is skipped where it is absent."""
    folder = Path(os.environ.get("EXCAVATWIN_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no real data: set EXCAVATWIN_DATA, or put it at {folder}")
    return folder


@pytest.fixture(scope="session")
def dig_site():
    """Observations of the tiny site (tests/tiny_site.py)."""
    import tiny_site

    return tiny_site.observations()


@pytest.fixture(scope="session")
def dig_site_trace(dig_site):
    """Its trace through the mapper with default parameters."""
    from excavatwin.mapper import Mapper

    return Mapper().trace(dig_site)


@pytest.fixture(scope="session")
def dig_site_map(dig_site_trace):
    """Its site."""
    from excavatwin.mapper import site_of

    return site_of(dig_site_trace)
