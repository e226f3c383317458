"""Calls in threads whose results keep their order."""

from threading import Barrier, Event

import pytest

from gsrain_engine.threads import results_in_order


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_come_in_the_order_of_the_calls(threads):
    calls = [(k, None if k % 3 == 0 else lambda k=k: k * k) for k in range(50)]
    expected = [(k, None if k % 3 == 0 else k * k) for k in range(50)]
    assert list(results_in_order(calls, threads)) == expected


def test_calls_run_at_once_and_few_are_taken_ahead():
    together, taken = Barrier(2, timeout=30), list[int]()

    def calls():
        for k in range(10):
            taken.append(k)
            yield k, together.wait  # each waits for another one

    results = results_in_order(calls(), 2)
    assert next(results)[0] == 0 and len(taken) <= 4
    assert [k for k, _ in results] == list(range(1, 10))


def test_an_error_ends_the_calls_that_have_not_begun():
    begun, may_end = list[int](), Event()

    def call(k):
        begun.append(k)
        if k == 0:
            may_end.wait(30)
            raise ValueError("no picture")

    calls = ((k, lambda k=k: call(k)) for k in range(100))
    results = results_in_order(calls, 2)
    may_end.set()
    with pytest.raises(ValueError, match="no picture"):
        list(results)
    assert len(begun) <= 4
