"""Where a network runs, in which precision, and what happens when its memory is too small."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

from excavatwin.errors import ExcavatwinError, InputError

T = TypeVar("T")


@dataclass(frozen=True)
class Device:
    """What a network runs on."""

    name: Literal["auto", "cpu", "cuda", "mps"] = "auto"
    """Processor: ``auto`` takes CUDA, else Apple's MPS, else the CPU."""
    precision: Literal["auto", "float32", "bfloat16", "float16"] = "auto"
    """Of the network's arithmetic: ``auto`` is bfloat16 where CUDA has it, float16 on older CUDA, else float32."""

    def torch(self) -> Any:
        """The ``torch.device``.

        Raises:
            InputError: the asked-for processor is not there.
        """
        import torch

        there = {"cpu": True, "cuda": torch.cuda.is_available(), "mps": torch.backends.mps.is_available()}
        if self.name == "auto":
            return torch.device(next(name for name in ("cuda", "mps", "cpu") if there[name]))
        if not there[self.name]:
            raise InputError(
                f"device {self.name} was asked for, but torch {torch.__version__} finds none here; use auto or cpu."
            )
        return torch.device(self.name)

    def dtype(self) -> Any:
        """The ``torch.dtype`` of autocast; float32 means none."""
        import torch

        if self.precision != "auto":
            return getattr(torch, self.precision)
        if self.torch().type != "cuda":
            return torch.float32
        return torch.bfloat16 if torch.cuda.get_device_capability()[0] >= 8 else torch.float16

    @contextmanager
    def inference(self) -> Iterator[Any]:
        """No gradients, autocast in the chosen precision; yields the ``torch.device``."""
        import torch

        device, dtype = self.torch(), self.dtype()
        with torch.inference_mode(), torch.autocast(device.type, dtype=dtype, enabled=dtype != torch.float32):
            yield device

    def free(self) -> float | None:
        """Memory that a network may take there [bytes]; None where that is not told."""
        import torch

        if self.torch().type == "cuda":
            return float(torch.cuda.mem_get_info()[0])
        if self.torch().type == "mps":
            return float(torch.mps.recommended_max_memory() - torch.mps.driver_allocated_memory())
        return None


def out_of_memory(error: BaseException) -> bool:
    """Whether an error says that memory ran out, on whatever device."""
    if isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError":
        return True
    text = str(error).lower()
    return isinstance(error, RuntimeError) and ("out of memory" in text or "not enough memory" in text)


def halving(
    run: Callable[[int], T], size: int, least: int, say: Callable[[str], None], unit: str = "images at a time"
) -> T:
    """``run(size)``, and again with half of it whenever memory runs out.

    Args:
        run: does the work with so many images at a time.
        size: images at a time to begin with.
        least: fewest images with which the work still makes sense.
        say: told each time, in one sentence.
        unit: what ``size`` counts, in words, when it is not images.

    Raises:
        InputError: memory does not suffice for ``least`` either.
    """
    while True:
        try:
            return run(size)
        except ExcavatwinError:
            raise
        except (MemoryError, RuntimeError) as error:
            if not out_of_memory(error):
                raise
        _release()  # out here the error is gone, and with it the tensors that its frames held
        if size <= least:
            raise InputError(
                f"memory ran out with {size} {unit.replace('images', 'image') if size == 1 else unit}; use a smaller "
                "lattice, --...device.name cpu, or a smaller model."
            ) from None
        smaller = max(least, size // 2)
        say(f"memory ran out with {size} {unit}; going on with {smaller}.")
        size = smaller


def _release() -> None:
    gc.collect()
    import sys

    torch = sys.modules.get("torch")
    if torch is not None and torch.cuda.is_available():
        torch.cuda.empty_cache()
