"""Failures."""

from __future__ import annotations


class Error(Exception):
    """Failure of SGS: one sentence that says what failed, why, and what to do.

    Sentences name the options of the command line; ``--resume`` is the argument ``resume`` here.

    Attributes:
        kind: ``usage``, ``input``, ``diverged``, ``locked``, ``device_lost``, ``out_of_memory``, ``terminated``,
            ``interrupted`` or ``failed``.
        status: Exit status of the command line: 1 failed, 2 wrong usage, 42 permanent, 75 try again, 130 interrupted.
    """

    kind: str
    status: int

    def __init__(self, text: str, kind: str = "failed", status: int = 1) -> None:
        super().__init__(text, kind, status)
        self.kind = kind
        self.status = status

    def __str__(self) -> str:
        return str(self.args[0])


def usage(text: str) -> Error:
    """Returns an error of wrong usage."""
    return Error(text, "usage", 2)
