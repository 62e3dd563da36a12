"""The error of a call that is refused."""

from __future__ import annotations

import pytest

from fracbench.errors import InputError


def refusal(call) -> str:
    """Return the message, one line, of the `InputError` that a call raises."""
    with pytest.raises(InputError) as caught:
        call()
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    return message
