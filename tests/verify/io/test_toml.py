import tomllib

from hypothesis import given
from hypothesis import strategies as st

from tests.support.strategies import texts
from verify.io.toml import encode

keys = st.sampled_from(["a", "b_mm", "led"])
scalars = st.booleans() | st.integers(-(2**63), 2**63 - 1) | texts | st.floats(allow_nan=False)
rows = st.lists(st.lists(st.floats(allow_nan=False), max_size=4), max_size=5)
values = scalars | st.lists(scalars, max_size=4) | rows
tables = st.dictionaries(keys, values | st.dictionaries(keys, scalars, min_size=1))


@given(tree=st.dictionaries(keys, values | tables | st.lists(tables, min_size=1, max_size=3)))
def test_what_is_encoded_reads_as_the_same_tables(tree: dict[str, object]) -> None:
    assert tomllib.loads(encode(tree).decode()) == tree


def test_a_value_that_is_none_is_left_out() -> None:
    assert encode({"a": None, "b": {"c": None, "d": 1}}) == b"\n[b]\nd = 1\n"
