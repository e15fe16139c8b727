"""Messages: frames in a stream, safetensors payloads, numbers as plain bytes. Standard library only.

A frame is the letters ``SGSP``, the payload's length as 64-bit little-endian number, and the payload: a safetensors file
whose metadata holds the message's text, a JSON object, under the key ``sgs``. See docs/guide/priors.md.
"""

import array
import json
import struct
import sys

MAGIC = b"SGSP"
VERSION = 1
#: Questions hold a few images; more is a mistake.
LIMIT = 1 << 30

#: Bytes for each number, by the type's name in safetensors.
SIZES = {"BOOL": 1, "U8": 1, "I8": 1, "U16": 2, "I16": 2, "F16": 2, "BF16": 2, "U32": 4, "I32": 4, "F32": 4,
         "U64": 8, "I64": 8, "F64": 8}
#: Letters of the array module for the types it has.
LETTERS = {"U8": "B", "U16": "H", "F32": "f"}


class ProtocolError(Exception):
    """The other side wrote something that is no message."""


class Array:
    """Numbers of one type in C order, as little-endian bytes."""

    def __init__(self, dtype, shape, data):
        self.dtype, self.shape, self.data = dtype, tuple(shape), data

    def __eq__(self, other):
        return (self.dtype, self.shape, bytes(self.data)) == (other.dtype, other.shape, bytes(other.data))

    def __repr__(self):
        return f"Array({self.dtype}, {list(self.shape)})"

    def numbers(self):
        """The numbers, one after the other."""
        if self.dtype == "F16":
            return struct.unpack(f"<{len(self.data) // 2}e", self.data)
        if self.dtype == "BOOL":
            return [b != 0 for b in self.data]
        numbers = array.array(LETTERS[self.dtype])
        numbers.frombytes(bytes(self.data))
        if sys.byteorder == "big":
            numbers.byteswap()
        return numbers


def pack(dtype, shape, numbers):
    """An array from numbers."""
    if dtype == "BOOL":
        return Array(dtype, shape, bytes(1 if n else 0 for n in numbers))
    if dtype == "F16":
        numbers = list(numbers)
        return Array(dtype, shape, struct.pack(f"<{len(numbers)}e", *numbers))
    packed = array.array(LETTERS[dtype], numbers)
    if sys.byteorder == "big":
        packed.byteswap()
    return Array(dtype, shape, packed.tobytes())


def encode(text, arrays):
    """A payload."""
    header, parts, offset = {"__metadata__": {"sgs": json.dumps(text)}}, [], 0
    # Readers want wide types first, so that everything is aligned.
    for name in sorted(arrays, key=lambda n: (-SIZES[arrays[n].dtype], n)):
        one = arrays[name]
        end = offset + len(one.data)
        header[name] = {"dtype": one.dtype, "shape": list(one.shape), "data_offsets": [offset, end]}
        parts.append(one.data)
        offset = end
    head = json.dumps(header).encode()
    head += b" " * (-len(head) % 8)
    return b"".join([struct.pack("<Q", len(head)), head, *parts])


def decode(payload):
    """Text and arrays of a payload."""
    try:
        (length,) = struct.unpack_from("<Q", payload)
        if length > len(payload) - 8:
            raise ProtocolError("the header is longer than the message")
        header = json.loads(bytes(payload[8:8 + length]))
        text = json.loads(header.pop("__metadata__")["sgs"])
        if not isinstance(text, dict):
            raise ProtocolError("the message's text is no object")
        arrays, data = {}, memoryview(payload)[8 + length:]
        for name, entry in header.items():
            start, end = entry["data_offsets"]
            count = 1
            for n in entry["shape"]:
                count *= n
            if not 0 <= start <= end <= len(data) or end - start != count * SIZES[entry["dtype"]]:
                raise ProtocolError(f"the array \"{name}\" does not fit its shape")
            arrays[name] = Array(entry["dtype"], entry["shape"], data[start:end])
        return text, arrays
    except (struct.error, ValueError, KeyError, TypeError, AttributeError) as e:
        raise ProtocolError(f"the message is no safetensors file with a text ({e})") from e


def write(stream, text, arrays=None):
    """Sends a message."""
    payload = encode(text, arrays or {})
    stream.write(MAGIC + struct.pack("<Q", len(payload)))
    stream.write(payload)
    stream.flush()


def read(stream, limit=LIMIT):
    """The next message as text and arrays; None where the stream ends between messages."""
    head = _exactly(stream, 12, at_start=True)
    if head is None:
        return None
    if head[:4] != MAGIC:
        raise ProtocolError(f"a message begins with {MAGIC}, not {head[:4]}")
    (length,) = struct.unpack("<Q", head[4:])
    if length > limit:
        raise ProtocolError(f"a message of {length} bytes is announced, but at most {limit} are taken")
    return decode(_exactly(stream, length))


def _exactly(stream, count, at_start=False):
    parts, left = [], count
    while left:
        part = stream.read(left)
        if not part:
            if at_start and left == count:
                return None
            raise ProtocolError("the stream ends within a message")
        parts.append(part)
        left -= len(part)
    return b"".join(parts)
