"""One small change of one function."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass


@dataclass(frozen=True)
class Mutant:
    """Replaces text[start:end] of a file.

    Attributes
    ----------
    path : from the top of the repository
    function : with the names of what it is in: Class.method
    line : of what changes, from 1
    start, end : characters of the file
    new : what takes their place
    fingerprint : of the function as it is, so that results of an older one do not count
    """

    path: str
    function: str
    line: int
    start: int
    end: int
    new: str
    fingerprint: str
    offset: int  # of start, from the function's own start

    @property
    def key(self) -> str:
        """The same as long as the function is, wherever in its file it stands."""
        return f"{self.path}:{self.function}:{self.fingerprint}:{self.offset}:{self.new}"

    def applied(self, text: str) -> str:
        return text[: self.start] + self.new + text[self.end :]

    def shown(self, text: str) -> tuple[str, str]:
        """The lines that change, before and after."""
        first = text.rfind("\n", 0, self.start) + 1
        last = text.find("\n", self.end)
        before = text[first:last]
        return before.strip(), (text[first : self.start] + self.new + text[self.end : last]).strip()


def fingerprint(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:10]
