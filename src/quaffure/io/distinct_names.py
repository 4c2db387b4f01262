"""Names that a file of a character gives to things, in one line and all different."""


def one_line(text: str) -> str:
    """A text of a file without what would break a line or a terminal."""
    return "".join(character if character.isprintable() else " " for character in text)


class DistinctNames:
    """Names in one line that differ, by numbers where those of a file do not: joints and clips are found by name."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}

    def add(self, name: str) -> str:
        """The name, with a number where it has been added before."""
        base = unused = one_line(name).strip()
        while unused in self._counts:
            self._counts[base] += 1
            unused = f"{base}#{self._counts[base]}"
        self._counts[unused] = 1
        return unused
