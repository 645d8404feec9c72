"""Strategies of hypothesis for what files hold."""

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

finite = st.floats(-10, 10, allow_subnormal=False)
positive = st.floats(1e-6, 0.9)
texts = st.text("aß 'o\"\\\n\t\x00\x1b\x7f#=[]{}😀", max_size=8)  # what TOML must escape, and more
every_disk = settings(max_examples=50)  # each example waits for the disk


def assert_same(a: object, b: object) -> None:
    """Compare field by field: 1e-12, for numbers pass through 15 digits and a change of units."""
    if hasattr(a, "__dataclass_fields__"):
        assert type(a) is type(b)
        for name in a.__dataclass_fields__:
            assert_same(getattr(a, name), getattr(b, name))
    elif isinstance(a, np.ndarray | float):
        assert isinstance(b, np.ndarray | float)
        assert_allclose(b, a, rtol=1e-12, atol=1e-12)
    else:
        assert a == b
