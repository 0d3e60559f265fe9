"""Questions of several pages, of which only the last of each is kept."""

from __future__ import annotations

import threading
from typing import Any


class Mailbox:
    """Where pages leave what they ask, until there is time for it; for several threads.

    A page that asks again before it was its turn does not wait for the answer to what it asked
    first: no picture is formed that nobody looks at. Pages take turns.
    """

    def __init__(self) -> None:
        self._waiting: dict[Any, Any] = {}
        self._arrived = threading.Condition()

    def put(self, page: Any, question: Any) -> None:
        """Leave a question in the place of the last one of that page."""
        with self._arrived:
            self._waiting[page] = question
            self._arrived.notify()

    def forget(self, page: Any) -> None:
        """Give up what a page has asked, which is gone."""
        with self._arrived:
            self._waiting.pop(page, None)

    def take(self, seconds: float) -> tuple[Any, Any] | None:
        """The page whose turn it is, and what it asks; ``None`` if nobody asks for so long."""
        with self._arrived:
            if not self._waiting:
                self._arrived.wait(seconds)
            if not self._waiting:
                return None
            page = next(iter(self._waiting))
            return page, self._waiting.pop(page)
