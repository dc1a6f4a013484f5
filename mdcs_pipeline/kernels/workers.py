"""How many threads work on an array, and its slices for them.

The number is a setting of the run that is under way. No result depends on it: threads share out
points, each of which is worked on alone.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: What users already limit threads with.
LIMITS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
# Of the work that is under way in this context, not of the process.
_COUNT: ContextVar[int] = ContextVar("threads", default=1)
# Fewer points than this are not worth a second thread.
_LEAST = 1000


def allowed_threads() -> int:
    """Return the most threads that may run: the processors open to us, or a smaller limit set."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    # OpenMP takes a list, for parallel regions within others; the first is the outer one.
    given = (os.environ.get(name, "").split(",")[0].strip() for name in LIMITS)
    return max(1, min([cores or 1, *(int(one) for one in given if one.isdecimal())]))


def thread_count() -> int:
    """Return the threads of the work that is under way."""
    return _COUNT.get()


@contextmanager
def threads(count: int) -> Iterator[int]:
    """Let what runs within use up to `count` threads, and no more than are allowed."""
    # One is always allowed, and asked for with every stage of every frame.
    granted = max(1, min(count, allowed_threads())) if count > 1 else 1
    token = _COUNT.set(granted)
    try:
        yield granted
    finally:
        _COUNT.reset(token)


def shared_out(
    work: Callable[[NDArray[np.int64]], Any], which: NDArray[np.int64]
) -> tuple[NDArray[Any], ...]:
    """Return the arrays that `work` gives for points, each thread's behind those before.

    Parameters
    ----------
    work : callable
        From some of the points to a tuple of arrays with a row for each; frees the GIL.
    which : (k,) int64
        All points to work on.
    """
    count = min(thread_count(), max(1, len(which) // _LEAST))
    if count == 1:
        return tuple(work(which))
    with ThreadPoolExecutor(count) as pool:
        parts = list(pool.map(work, np.array_split(which, count)))
    return tuple(np.concatenate(held) for held in zip(*parts, strict=True))


def per_point(
    which: NDArray[np.int64], kernel: Callable[..., NDArray[Any]], *given: Any
) -> NDArray[Any]:
    """Return the array that `kernel(*given, some)` gives for points, shared out to threads."""
    return shared_out(lambda some: (kernel(*given, some),), which)[0]
