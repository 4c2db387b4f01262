"""The one error that a user's mistake raises."""

from pathlib import Path


class InputError(ValueError):
    """Bad input: which source, what was expected there and what was found. The command line prints it as one line.

    Args:
        source: the file, option or argument at fault.
        expected: what a good input would have held.
        found: what this one holds.
    """

    def __init__(self, source: str | Path, expected: str, found: str) -> None:
        super().__init__(f"{source}: expected {expected}, found {found}")
        self.source, self.expected, self.found = str(source), expected, found
