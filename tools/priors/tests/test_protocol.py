"""The protocol and its service, with nothing but the standard library."""

import io
import json
import os
import struct
import subprocess
import sys
import unittest

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
sys.path.insert(0, ROOT)

from sgs_priors import protocol, service  # noqa: E402
from sgs_priors.protocol import Array, ProtocolError, pack  # noqa: E402


class Messages(unittest.TestCase):
    def sample(self):
        return {"kind": "answer", "text": "größer \"x\""}, {
            "a": pack("F32", (2, 2), [0.5, -1, float("inf"), 4]), "b": pack("U8", (3,), [1, 2, 255]),
            "c": pack("F16", (2,), [0.5, -2]), "d": pack("BOOL", (2, 1), [True, False]), "e": pack("U16", (1,), [65535]),
        }

    def test_round_trip(self):
        text, arrays = self.sample()
        stream = io.BytesIO()
        for _ in range(2):
            protocol.write(stream, text, arrays)
        stream.seek(0)
        for _ in range(2):
            self.assertEqual(protocol.read(stream), (text, arrays))
        self.assertIsNone(protocol.read(stream))
        self.assertEqual(list(arrays["c"].numbers()), [0.5, -2])
        self.assertEqual(list(arrays["d"].numbers()), [True, False])
        self.assertEqual(list(arrays["e"].numbers()), [65535])

    def test_layout_is_that_of_safetensors(self):
        payload = protocol.encode(*self.sample())
        (length,) = struct.unpack_from("<Q", payload)
        header = json.loads(payload[8:8 + length])
        self.assertEqual(length % 8, 0)
        self.assertEqual(header["a"], {"dtype": "F32", "shape": [2, 2], "data_offsets": [0, 16]})
        self.assertEqual(set(header["__metadata__"]), {"sgs"})
        ends = [d["data_offsets"] for n, d in header.items() if n != "__metadata__"]
        self.assertEqual([e for _, e in ends][:-1], [b for b, _ in ends][1:])
        self.assertEqual(ends[-1][1], len(payload) - 8 - length)

    def test_any_cut_is_an_error(self):
        stream = io.BytesIO()
        protocol.write(stream, *self.sample())
        whole = stream.getvalue()
        for length in range(1, len(whole)):
            with self.assertRaises(ProtocolError):
                protocol.read(io.BytesIO(whole[:length]))
        with self.assertRaisesRegex(ProtocolError, "begins with"):
            protocol.read(io.BytesIO(b"X" * 40))
        with self.assertRaisesRegex(ProtocolError, "at most"):
            protocol.read(io.BytesIO(b"SGSP" + struct.pack("<Q", 1 << 40)))

    def test_lies_about_arrays_are_errors(self):
        def payload(entry):
            head = json.dumps({"__metadata__": {"sgs": "{}"}, "x": entry}).encode()
            return struct.pack("<Q", len(head)) + head + b"1234"
        good = {"dtype": "U8", "shape": [4], "data_offsets": [0, 4]}
        self.assertEqual(bytes(protocol.decode(payload(good))[1]["x"].data), b"1234")
        for change in ({"shape": [5]}, {"data_offsets": [0, 5]}, {"data_offsets": [3, 1]}, {"dtype": "X9"},
                       {"shape": None}, {"data_offsets": [1]}):
            with self.assertRaises(ProtocolError, msg=change):
                protocol.decode(payload({**good, **change}))


class Doubler:
    name = "doubler"
    offers = {"double": {}, "fail": {}}

    def answer(self, question):
        if question.name == "fail":
            print("this goes nowhere near the protocol")
            raise ValueError("it\nfailed")
        image = question.images[0]
        return {"seed": question.seed}, {"twice": Array(image.dtype, image.shape, bytes(2 * b for b in image.data))}


class Service(unittest.TestCase):
    def talk(self, messages, make=Doubler):
        source, sink = io.BytesIO(), io.BytesIO()
        for text, arrays in messages:
            protocol.write(source, text, arrays)
        source.seek(0)
        service.serve(make, source, sink)
        sink.seek(0)
        return list(iter(lambda: protocol.read(sink), None))

    hello = ({"kind": "hello", "versions": [1, 3]}, {})

    def test_greeting_answers_and_refusals(self):
        image = {"image0": pack("U8", (1, 1, 3), [1, 2, 3])}
        answers = self.talk([
            self.hello,
            ({"kind": "question", "id": 1, "question": "double", "views": [{}], "seed": 7}, image),
            ({"kind": "question", "id": 2, "question": "fail"}, image),
            ({"kind": "question", "id": 3, "question": "__init__"}, image),
            ({"kind": "question", "id": 4, "question": "double"}, image),
        ])
        (greeting, _), (text, arrays), (failed, _), (unknown, _), (last, _) = answers
        self.assertEqual((greeting["kind"], greeting["version"], greeting["offers"]), ("hello", 1, Doubler.offers))
        self.assertEqual((text["kind"], text["to"], text["seed"]), ("answer", 1, 7))
        self.assertEqual(bytes(arrays["twice"].data), bytes([2, 4, 6]))
        self.assertEqual(failed, {"kind": "error", "to": 2, "text": "ValueError: it\nfailed"})
        self.assertEqual((unknown["kind"], unknown["text"]), ("error", "\"__init__\" is not offered"))
        self.assertEqual(last["to"], 4)

    def test_failures_are_reported(self):
        def make():
            raise service.Refusal("there are no weights")
        self.assertEqual(self.talk([self.hello], make), [({"kind": "error", "text": "there are no weights"}, {})])
        ((refusal, _),) = self.talk([({"kind": "hello", "versions": [2, 3]}, {})])
        self.assertIn("version 1 of the protocol is spoken here, but 2 to 3 are wanted", refusal["text"])
        self.assertEqual(self.talk([]), [])

    def test_several_in_one(self):
        class Other(Doubler):
            name = "other"
            offers = {"double": {"max_side": 5}, "more": {}}
        both = service.Several([Doubler(), Other()])
        self.assertEqual(both.offers, {"double": {}, "fail": {}, "more": {}})
        self.assertEqual(both.name, "doubler, other")

    def test_prints_do_not_reach_the_protocol(self):
        code = ("import sys; sys.path.insert(0, sys.argv[1]); from sgs_priors import service\n"
                "class S:\n name, offers = 's', {}\n"
                "def make():\n print('loading'); import os; os.system('echo from a child'); return S()\n"
                "service.serve(make)")
        stream = io.BytesIO()
        protocol.write(stream, *self.hello)
        done = subprocess.run([sys.executable, "-c", code, ROOT], input=stream.getvalue(), capture_output=True, check=True)
        ((text, _),) = [protocol.read(io.BytesIO(done.stdout))]
        self.assertEqual(text["kind"], "hello")
        self.assertIn("from a child", done.stderr.decode())
        self.assertIn("loading", done.stderr.decode())

    def test_wrong_usage(self):
        for arguments in (["nonsense=x"], ["stand-in"], []):
            done = subprocess.run([sys.executable, os.path.join(ROOT, "serve"), *arguments], capture_output=True)
            self.assertEqual(done.returncode, 2, done.stderr)


if __name__ == "__main__":
    unittest.main()
