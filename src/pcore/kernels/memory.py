"""Keep freed memory inside the process.

By default glibc hands every large freed block back to the system, and the next tensor of that size
pays for fresh pages again: on small models that costs more than the arithmetic.
"""

from __future__ import annotations

import ctypes

_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -2, -3, -8
_LARGEST_MMAP_THRESHOLD = 32 * 2**20


def keep_freed_memory() -> bool:
    """Ask glibc to reuse freed blocks of up to 32 MiB; call it once, before large allocations.

    Returns:
        Whether the C library took the settings (False on systems without glibc's mallopt).
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return False
    taken = [
        # One arena: the others live in heaps of 64 MiB that are trimmed whatever we ask.
        mallopt(_M_ARENA_MAX, 1),
        mallopt(_M_MMAP_THRESHOLD, _LARGEST_MMAP_THRESHOLD),
        mallopt(_M_TRIM_THRESHOLD, 2**31 - 1),
        mallopt(_M_TOP_PAD, 64 * 2**20),
    ]
    return all(taken)
