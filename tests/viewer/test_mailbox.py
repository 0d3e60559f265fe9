"""Questions of pages that wait: only the last of each is kept."""

import threading

from potmesil_mi.viewer.mailbox import Mailbox


def test_a_question_takes_the_place_of_the_last_one_of_its_page():
    mailbox = Mailbox()
    for number in range(5):
        mailbox.put("page", number)
    assert mailbox.take(0) == ("page", 4)
    assert mailbox.take(0) is None


def test_pages_take_turns():
    mailbox = Mailbox()
    mailbox.put("one", 1)
    mailbox.put("two", 2)
    mailbox.put("one", 3)
    assert [mailbox.take(0), mailbox.take(0)] == [("one", 3), ("two", 2)]


def test_what_a_page_asked_that_is_gone_is_not_answered():
    mailbox = Mailbox()
    mailbox.put("gone", 1)
    mailbox.forget("gone")
    mailbox.forget("never there")
    assert mailbox.take(0) is None


def test_a_question_of_another_thread_is_taken_as_soon_as_it_is_there():
    mailbox = Mailbox()
    threading.Timer(0.05, mailbox.put, ("page", "question")).start()
    assert mailbox.take(60) == ("page", "question")
