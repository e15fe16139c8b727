"""Serving: greeting, questions, answers, refusals.

A service has ``offers``, a dictionary from the names of questions to what is said about them in the greeting, and
``answer(question)``, which returns the answer's text and arrays, or raises :class:`Refusal`.
"""

import os
import sys
import traceback

from . import __version__, protocol


class Refusal(Exception):
    """A question that cannot be answered; the words go to the person who asked."""


class Question:
    """A question: its name, text and arrays."""

    def __init__(self, text, arrays):
        self.name, self.text, self.arrays = text.get("question", ""), text, arrays

    @property
    def seed(self):
        """The seed of everything random in the answer."""
        return int(self.text.get("seed", 42))

    @property
    def images(self):
        """All images, in order."""
        found = []
        while f"image{len(found)}" in self.arrays:
            found.append(self.arrays[f"image{len(found)}"])
        return found

    def hint(self, index, name):
        """What is known about an image beside its pixels ("name", "camera"), or None."""
        views = self.text.get("views", [])
        return views[index].get(name) if index < len(views) else None


class Several:
    """Services side by side in one process; the first that offers an answer gives it."""

    def __init__(self, services):
        self.services = services
        self.name = ", ".join(s.name for s in services)
        self.offers = {}
        for service in reversed(services):
            self.offers.update(service.offers)

    def answer(self, question):
        """The answer of the first service that offers it."""
        return next(s for s in self.services if question.name in s.offers).answer(question)


def claim_output():
    """The stream of the protocol. Whatever else is printed goes to standard error from now on."""
    stream = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return stream


def serve(make, source=None, sink=None):
    """Greets, builds the service by ``make()``, and answers until the input ends."""
    sink = sink or claim_output()
    source = source or sys.stdin.buffer
    greeting = protocol.read(source)
    if greeting is None:
        return
    lowest, highest = greeting[0].get("versions", [0, 0])
    if not lowest <= protocol.VERSION <= highest:
        text = f"version {protocol.VERSION} of the protocol is spoken here, but {lowest} to {highest} are wanted"
        protocol.write(sink, {"kind": "error", "text": text})
        return
    try:
        service = make()
    except Exception as e:  # noqa: BLE001 - whatever goes wrong is to be said
        if not isinstance(e, Refusal):
            traceback.print_exc()
        protocol.write(sink, {"kind": "error", "text": _words(e)})
        return
    protocol.write(sink, {"kind": "hello", "version": protocol.VERSION, "name": f"{service.name} ({__version__})",
                          "offers": service.offers})
    while (message := protocol.read(source)) is not None:
        question = Question(*message)
        to = question.text.get("id")
        try:
            if question.name not in service.offers:
                raise Refusal(f"\"{question.name}\" is not offered")
            text, arrays = service.answer(question)
            text = {"kind": "answer", "to": to, **text}
        except Exception as e:  # noqa: BLE001 - one failed question need not be the end
            if not isinstance(e, Refusal):
                traceback.print_exc()
            text, arrays = {"kind": "error", "to": to, "text": _words(e)}, {}
        protocol.write(sink, text, arrays)


def _words(error):
    return str(error) if isinstance(error, Refusal) else f"{type(error).__name__}: {error}"
