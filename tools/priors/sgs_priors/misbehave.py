"""A provider that does one thing wrong on purpose, to test whoever speaks with it. Standard library only."""

import json
import os
import struct
import subprocess
import sys
import time

from . import protocol
from .protocol import pack

OFFERS = {"depth": {}, "normals": {}, "semantics": {}, "text": {}, "masks": {}, "regions": {},
          "materials": {"maps": ["albedo", "roughness", "metallic"]}}


def good(question, height, width):
    """An answer that nobody can complain about."""
    pixels = height * width
    text = {"frame": "camera-opengl", "meaning": "scale", "color": "srgb", "names": question.get("names", [])}
    arrays = {
        "depth": pack("F32", (height, width), [2.0] * pixels),
        "confidence": pack("F32", (height, width), [0.5] * pixels),
        "normals": pack("F32", (height, width, 3), [0.0, 0.0, 1.0] * pixels),
        "features": pack("F16", (1, 1, 512), [0.5] * 512),
        "embeddings": pack("F32", (len(text["names"]), 512), [0.5] * 512 * len(text["names"])),
        "masks": pack("BOOL", (3, height, width), [True] * 3 * pixels),
        "regions": pack("U16", (height, width), [1] * pixels),
        "albedo": pack("F32", (height, width, 3), [0.5] * 3 * pixels),
        "roughness": pack("F32", (height, width), [0.5] * pixels),
        "metallic": pack("F32", (height, width), [0.0] * pixels),
    }
    return text, arrays


def spoil(how, text, arrays):
    """The answers that are messages, but not right."""
    shape = arrays["normals"].shape
    zeros = bytes(4 * shape[0] * shape[1] * shape[2])
    changes = {
        "missing-array": lambda: arrays.pop("normals"),
        "wrong-shape": lambda: arrays.update(normals=protocol.Array("F32", shape[::-1], zeros)),
        "wrong-type": lambda: arrays.update(normals=protocol.Array("U8", shape, zeros[:len(zeros) // 4])),
        "unknown-type": lambda: arrays.update(normals=protocol.Array("I32", shape, zeros)),
        "wrong-frame": lambda: text.update(frame="sideways"),
        "wrong-meaning": lambda: text.update(meaning="near"),
        "wrong-confidence": lambda: arrays.update(confidence=pack("F32", shape[:2], [1.5] * (shape[0] * shape[1]))),
        "no-frame": lambda: text.pop("frame"),
        "wrong-color": lambda: text.update(color="cmyk"),
        "wrong-id": lambda: text.update(to=text["to"] + 1),
        "wrong-kind": lambda: text.update(kind="applause"),
        "wrong-names": lambda: text.update(names=["something else"]),
        "bool-two": lambda: arrays.update(masks=protocol.Array("BOOL", arrays["masks"].shape,
                                                               bytes([2] * len(arrays["masks"].data)))),
        "refuse": lambda: text.update(kind="error", text="no such\nthing is known"),
    }
    for number, value in (("nan", float("nan")), ("infinite", float("inf"))):
        def poison(value=value):
            for name in ("normals", "depth", "features", "albedo"):
                numbers = list(arrays[name].numbers())
                numbers[2] = value
                arrays[name] = pack(arrays[name].dtype, arrays[name].shape, numbers)
        changes[number] = poison
    if how in changes:
        changes[how]()


def frame(payload, length=None, magic=protocol.MAGIC):
    """The bytes of a message, or of something like it."""
    return magic + struct.pack("<Q", len(payload) if length is None else length) + payload


def head(text):
    """A payload with this text and no arrays."""
    header = json.dumps({"__metadata__": {"sgs": text}}).encode()
    return struct.pack("<Q", len(header)) + header


def act(how, sink, payload):
    """Writes an answer in a wrong way; true if it did."""
    if how == "hang":
        time.sleep(600)
    elif how == "hang-deaf":
        # A helper in the same group holds the pipes open, and nobody listens to closing inputs.
        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)", *sys.argv[1:]])
        time.sleep(600)
    elif how == "exit":
        print("CUDA out of memory", file=sys.stderr, flush=True)
        os._exit(3)
    elif how == "exit-quietly":
        os._exit(0)
    elif how == "signal":
        os.kill(os.getpid(), 9)
    elif how == "crash-amid":
        sink.write(frame(payload)[:len(payload) // 2])
        sink.flush()
        print("segmentation fault, or so", file=sys.stderr, flush=True)
        os._exit(1)
    elif how == "hang-amid":
        sink.write(frame(payload)[:len(payload) // 2])
        sink.flush()
        time.sleep(600)
    elif how == "garbage":
        sink.write(b"Loading checkpoint shards: 100%\n")
    elif how == "huge-length":
        sink.write(frame(payload, length=1 << 60))
    elif how == "over-limit":
        sink.write(frame(payload, length=(1 << 30) + 1))
    elif how == "not-safetensors":
        sink.write(frame(b"\xff" * 64))
    elif how == "short-payload":
        sink.write(frame(payload[:len(payload) // 2]))
    elif how == "no-text":
        sink.write(frame(struct.pack("<Q", 2) + b"{}"))
    elif how == "not-json":
        sink.write(frame(head("this is not JSON")))
    elif how == "not-an-object":
        sink.write(frame(head("[1, 2]")))
    elif how == "close-output":
        os.close(1)
        time.sleep(600)
    elif how == "slow":
        time.sleep(0.3)
        sink.write(frame(payload))
    elif how == "trickle":
        for byte in frame(payload):
            sink.write(bytes([byte]))
            sink.flush()
    elif how == "flood":
        for i in range(20_000):
            print(f"line {i} of a talkative library, which goes on and on", file=sys.stderr)
        sink.write(frame(payload))
    elif how == "flood-forever":
        while True:
            print("still loading", file=sys.stderr)
    elif how == "long-line":
        sys.stderr.write("x" * 3_000_000 + "\n")
        sys.stderr.flush()
        sink.write(frame(payload))
    else:
        return False
    sink.flush()
    return True


def greet(how, sink):
    """The greeting, or what comes in its place."""
    offers = dict(OFFERS)
    if how == "few-offers":
        offers = {"text": {}}
    elif how == "linear":
        offers["normals"] = {"image": "linear", "max_side": 16, "unknown": [1, 2]}
    elif how == "wrong-offer":
        offers["normals"] = {"image": "sepia"}
    version = {"old-version": 0, "new-version": 99}.get(how, protocol.VERSION)
    text = {"kind": "hello", "version": version, "name": "misbehave " + how, "offers": offers, "later": "field"}
    if how == "no-hello":
        text["kind"] = "answer"
    elif how == "no-version":
        del text["version"]
    elif how == "cannot-load":
        text = {"kind": "error", "text": "there are no weights at /nowhere"}
    protocol.write(sink, text)


def main(how):
    """Speaks, and misbehaves: "greeting-HOW" at once, "HOW" at the first question."""
    source, sink = sys.stdin.buffer, sys.stdout.buffer
    if how == "print":
        print("a library says hello", flush=True)
    protocol.read(source)
    if how.startswith("greeting-"):
        act(how.removeprefix("greeting-"), sink, protocol.encode({"kind": "hello"}, {}))
    greet(how, sink)
    if how == "stop-reading":
        time.sleep(600)
    while (message := protocol.read(source)) is not None:
        question, images = message
        image = images.get("image0")
        height, width = image.shape[:2] if image else (1, 1)
        text, arrays = good(question, height, width)
        text = {"kind": "answer", "to": question["id"], **text}
        spoil(how, text, arrays)
        if not act(how, sink, protocol.encode(text, arrays)):
            protocol.write(sink, text, arrays)
    if how == "stay":
        time.sleep(600)
