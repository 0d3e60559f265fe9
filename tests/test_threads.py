"""Jobs behind one's back: in order, bounded, and their errors come out."""

import threading

import pytest

from potmesil_mi import _backend, _threads
from potmesil_mi._threads import Behind


def test_jobs_are_done_in_order_and_all_of_them_at_the_end_of_the_block():
    done = []
    with Behind() as behind:
        for i in range(20):
            behind.do(lambda i=i: done.append((i, threading.current_thread())))
    assert [i for i, _ in done] == list(range(20))
    assert all(thread is not threading.main_thread() for _, thread in done)


def test_so_many_jobs_wait_and_no_more():
    go, asked = threading.Event(), []

    def ask(behind):
        for i in range(10):
            behind.do(go.wait)
            asked.append(i)

    with Behind() as behind:
        other = threading.Thread(target=ask, args=(behind,))
        other.start()
        other.join(0.5)
        assert other.is_alive()
        assert len(asked) <= _threads.MOST_WAITING + 1
        go.set()
        other.join()
    assert len(asked) == 10


def test_the_error_of_a_job_comes_out_and_no_job_is_done_after_it():
    done = []

    def both():
        with Behind() as behind:
            behind.do(lambda: 1 / 0)
            behind.do(lambda: done.append(1))

    with pytest.raises(ZeroDivisionError):
        both()
    assert done == []


def test_an_error_of_the_block_itself_is_the_one_that_is_told():
    done = []

    def both():
        with Behind() as behind:
            behind.do(lambda: done.append(1))
            raise KeyError

    with pytest.raises(KeyError):
        both()
    assert done == [1]


def test_sums_are_scattered_as_if_the_thread_were_not_there():
    go = threading.Event()
    alone = _backend.evaluates_alone()
    with Behind() as behind:
        behind.do(go.wait)
        assert _backend.evaluates_alone() == alone
        go.set()
    other = threading.Thread(target=go.wait)
    go.clear()
    other.start()
    assert not _backend.evaluates_alone()
    go.set()
    other.join()


def test_who_knows_that_other_threads_evaluate_nothing_may_say_so():
    go = threading.Event()
    other = threading.Thread(target=go.wait)
    other.start()
    try:
        with _backend.alone():
            assert _backend.evaluates_alone()
        assert not _backend.evaluates_alone()
    finally:
        go.set()
        other.join()
