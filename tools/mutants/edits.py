"""Small changes of a source file."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Edit:
    """A part of a file, in bytes from `start` to `end`, that another text replaces."""

    start: int
    end: int
    text: str

    def applied(self, source: bytes) -> bytes:
        """The changed file."""
        return source[: self.start] + self.text.encode() + source[self.end :]

    def line(self, source: bytes) -> int:
        """The number of the first line that changes, from 1."""
        return source.count(b"\n", 0, self.start) + 1

    def shown(self, source: bytes) -> tuple[str, str]:
        """The lines that change, before and after, each without line breaks and indentation."""
        first = source.rfind(b"\n", 0, self.start) + 1
        last = source.find(b"\n", self.end)
        last = len(source) if last < 0 else last
        after = source[first : self.start] + self.text.encode() + source[self.end : last]
        return _in_one_line(source[first:last]), _in_one_line(after)


def _in_one_line(text: bytes) -> str:
    return " ".join(text.decode().split())
