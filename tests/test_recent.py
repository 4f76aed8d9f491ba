"""What is computed once is kept for the very objects it was computed from, and no more of it than asked."""

from cdm_pin.recent import Recent


def test_the_oldest_go_until_the_rest_is_small():
    recent, owners = Recent(4), [object() for _ in range(3)]
    for size, owner in zip((5, 3, 2), owners, strict=True):
        recent.keep(size, owner)
    recent.shrink(lambda kept: sum(kept) <= 5)
    assert [recent.get(owner) for owner in owners] == [None, 3, 2]
    recent.shrink(lambda kept: False)
    assert recent.values() == []
