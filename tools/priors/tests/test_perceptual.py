"""Weights of LPIPS: what becomes of state dicts, and what is said of others. Arrays are imitated; torch is not needed."""

import json
import os
import struct
import sys
import tempfile
import unittest

sys.path.insert(0, os.path.dirname(os.path.dirname(os.path.abspath(__file__))))

from sgs_priors import lpips_weights  # noqa: E402


class Array:
    """As much of an array as is asked for: zeros that begin with a number."""

    def __init__(self, shape, first):
        self.shape, self.first = tuple(shape), first
        self.size = 1
        for n in shape:
            self.size *= n

    def astype(self, kind):
        assert kind == "<f4"
        return self

    def tobytes(self):
        return struct.pack("<f", self.first) + bytes(4 * self.size - 4)


def states(net):
    found = {"features": {}, "heads": {}}
    for i, (_, shape, where, key) in enumerate(lpips_weights.shapes(net)):
        found[where][key] = Array((1, *shape, 1, 1) if where == "heads" else shape, i + 0.5)
    return found["features"], found["heads"]


class Weights(unittest.TestCase):
    def test_numbers_stand_where_the_header_says(self):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "alex.safetensors")
            lpips_weights.convert("alex", *states("alex"), path)
            self.assertEqual(os.listdir(folder), ["alex.safetensors"])
            with open(path, "rb") as f:
                data = f.read()
        (length,) = struct.unpack_from("<Q", data)
        header = json.loads(data[8:8 + length])
        self.assertEqual(length % 8, 0)
        self.assertEqual(header.pop("__metadata__"), {"format": "sgs-lpips-1", "net": "alex", "version": "0.1"})
        end = 0
        for i, (name, shape, _, _) in enumerate(lpips_weights.shapes("alex")):
            tensor = header.pop(name)
            begin, after = tensor["data_offsets"]
            self.assertEqual((tensor["dtype"], tuple(tensor["shape"]), begin), ("F32", shape, end))
            self.assertEqual(struct.unpack_from("<f", data, 8 + length + begin), (i + 0.5,))
            end = after
        self.assertEqual((header, len(data)), ({}, 8 + length + end))

    def test_others_are_refused_and_nothing_is_written(self):
        features, heads = states("alex")
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "o")
            for net, tensors, words in [
                ("vgg", (features, heads), '"features.0.weight" of --features is (64, 3, 11, 11)'),
                ("alex", ({**features, "features.3.bias": Array((9,), 0)}, heads), '"features.3.bias"'),
                ("alex", (heads, features), '--features has no "features.0.weight"'),
                ("alex", (features, {}), '--heads has no "lin0.model.1.weight"; is it of alex?'),
            ]:
                with self.assertRaises(ValueError) as caught:
                    lpips_weights.convert(net, *tensors, path)
                self.assertIn(words, str(caught.exception))
            self.assertEqual(os.listdir(folder), [])


if __name__ == "__main__":
    unittest.main()
