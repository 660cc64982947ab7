"""The journal of a run: what becomes ``run.json``."""

from __future__ import annotations

import contextlib
import platform
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import excavatwin

LIBRARIES = (
    "numpy",
    "scipy",
    "numba",
    "opencv-python-headless",
    "pycolmap",
    "pillow",
    "av",
    "xarray",
    "h5netcdf",
    "rasterio",
    "pyproj",
    "laspy",
    "matplotlib",
)
"""Libraries whose version can change a result."""


def versions() -> dict[str, str]:
    """Versions of ExcavaTwin, Python and every library that can change a result; "missing" where there is none."""
    found = {"excavatwin": excavatwin.__version__, "python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "missing"
    return found


def peak_memory() -> int:
    """Largest resident size of this process so far [bytes]; 0 where the system does not tell."""
    try:
        import resource
    except ImportError:  # pragma: no cover - Windows
        return 0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


@dataclass
class Journal:
    """Collects stage times, warnings and everything else that a later reader of the map wants to know."""

    stages: dict[str, dict[str, Any]] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    started: float = field(default_factory=time.time)

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[dict[str, Any]]:
        """Time a stage; the yielded row takes further facts (``cached``, counts)."""
        row: dict[str, Any] = {"cached": False}
        begin, cpu = time.perf_counter(), time.process_time()
        yield row
        row["seconds"] = round(time.perf_counter() - begin, 3)
        row["cpu_seconds"] = round(time.process_time() - cpu, 3)
        row["peak_memory_bytes"] = peak_memory()
        self.stages[name] = row

    def note(self, *sentences: str) -> None:
        """Remember warnings, each once, in order."""
        self.warnings += [s for s in dict.fromkeys(sentences) if s not in self.warnings]

    def report(self, **facts: Any) -> dict[str, Any]:
        """The content of ``run.json``."""
        return {
            "versions": versions(),
            "platform": platform.platform(),
            "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(self.started)),
            **facts,
            "stages": self.stages,
            "seconds": round(sum(row["seconds"] for row in self.stages.values()), 3),
            "peak_memory_bytes": peak_memory(),
            "warnings": self.warnings,
        }
