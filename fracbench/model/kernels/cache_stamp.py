"""The one private interface of numba that the model uses: the stamp of a function's cache.

Numba takes a cached function for valid as long as its own file has not changed, although the functions that it
calls are compiled into it and may stand in other files. Numba has no public way to add to that stamp.
"""

from __future__ import annotations

from typing import Any


def add_to_stamp(compiled: Any, digest: str) -> bool:
    """Make `digest` part of the stamp of a function's cache; return False if numba no longer has such a stamp."""
    cache: Any = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if not hasattr(cache, "_source_stamp"):
        return False
    cache._source_stamp = cache._source_stamp, digest
    return True
