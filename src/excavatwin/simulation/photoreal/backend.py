"""Mitsuba 3 and its LLVM variant: loaded on first use, or one sentence that says what is missing."""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from excavatwin.errors import MissingExtraError

VARIANT = "llvm_ad_rgb"
"""Single precision, red green blue, compiled for all lanes of this processor. ``scalar_rgb`` took as long for its own
path tracer (docs/simulator.md), but cannot run the integrator of ``lighting``."""


class Backend(NamedTuple):
    """The two modules that the renderer is written against."""

    mi: Any
    dr: Any


@cache
def backend() -> Backend:
    """Mitsuba with its variant set, and Dr.Jit.

    Raises:
        MissingExtraError: Mitsuba is not installed, is too old for its ``sunsky`` emitter, or LLVM's library is absent.
    """
    try:
        import drjit as dr
        import mitsuba as mi
    except ImportError as error:
        raise MissingExtraError(
            f"the photorealistic renderer needs Mitsuba 3, which cannot be imported ({error}); "
            'pip install "excavatwin[sim]", or use --renderer fast.'
        ) from error
    _require_llvm(dr)
    mi.set_variant(VARIANT)
    try:
        mi.load_dict({"type": "sunsky"})
    except RuntimeError as error:
        raise MissingExtraError(
            f"Mitsuba {mi.__version__} has no sun and sky emitter, 3.9 has; "
            'pip install --upgrade "excavatwin[sim]" "mitsuba>=3.9".'
        ) from error
    return Backend(mi, dr)


def _require_llvm(dr: ModuleType) -> None:
    if not dr.has_backend(dr.JitBackend.LLVM):
        raise MissingExtraError(
            "Mitsuba's LLVM variant found no LLVM library; apt install libllvm19 (older ones abort), or set "
            "DRJIT_LIBLLVM_PATH to libLLVM.so, or use --renderer fast."
        )


def vectors(values: Float[np.ndarray, "n 3"]) -> Any:
    """Rows as a Dr.Jit array of 3-vectors."""
    mi = backend().mi
    return mi.Vector3f(*(mi.Float(np.ascontiguousarray(column, np.float32)) for column in np.asarray(values).T))
