import numpy as np
import pytest

from verify.live.buffers import ReadingSeries


def test_it_holds_what_a_list_would() -> None:
    rng, store, kept = np.random.default_rng(4), ReadingSeries(), []
    assert store.copied(0) is None
    for number in range(3000):
        q = rng.normal(size=6)
        store.add(0.01 * number, q)
        kept.append((0.01 * number, q))
        if number % 7 == 0:
            store.drop_before(0.01 * (number - 500))
            kept = [row for row in kept if row[0] >= 0.01 * (number - 500)]
        if number % 101 == 0:
            begin = int(rng.integers(0, len(kept)))
            copied = store.copied(begin)
            assert copied.t.tolist() == [t for t, _ in kept[begin:]]
            np.testing.assert_array_equal(copied.q, [q for _, q in kept[begin:]])
    assert store.copied(len(kept)) is None


def test_what_was_copied_stays_as_it_was() -> None:
    store = ReadingSeries()
    store.add(1.0, np.ones(6))
    copied = store.copied(0)
    store.clear()
    store.add(2.0, np.zeros(6))
    assert copied.t.tolist() == [1.0]
    assert copied.q.tolist() == [[1.0] * 6]
    assert store.t.tolist() == pytest.approx([2.0])
