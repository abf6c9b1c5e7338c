"""Rows dealt out to nodes that come and go: each once, neighbours together."""

from render.shares import Shares


def test_one_node_gets_all_in_order():
    shares = Shares(10)
    taken = [list(shares.take("a", 4)) for _ in range(4)]
    assert taken == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9], []]


def test_a_second_node_takes_the_far_half_and_is_helped_when_it_is_slow():
    shares = Shares(16)
    assert list(shares.take("a", 4)) == [0, 1, 2, 3]
    assert list(shares.take("b", 4)) == [10, 11, 12, 13]
    assert list(shares.take("a", 8)) == [4, 5, 6, 7, 8, 9]
    assert list(shares.take("a", 8)) == [15]
    assert list(shares.take("a", 8)) == [14]
    assert list(shares.take("b", 8)) == []


def test_what_a_lost_node_had_is_rendered_by_others():
    shares = Shares(16)
    shares.take("a", 4)
    lost = shares.take("b", 4)
    shares.leave("b")
    shares.give_back(lost)
    left = [position for _ in range(9) for position in shares.take("a", 3)]
    assert sorted(left) == list(range(4, 16))


def test_a_row_that_a_node_has_failed_at_goes_to_another():
    shares = Shares(2)
    shares.take("a", 2)
    shares.give_back([1], avoiding="a")
    assert list(shares.take("a", 4)) == []
    assert list(shares.take("b", 4)) == [1]
    shares.give_back([1], avoiding="b")
    assert list(shares.take("a", 4)) == []
    assert list(shares.take("a", 4, only=True)) == [1]


def test_no_rows_no_work():
    assert list(Shares(0).take("a", 4)) == []
