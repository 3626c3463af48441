"""Ways in which files go wrong: cut short, bits turned, numbers and words exchanged."""

from __future__ import annotations

import copy
import json
from random import Random
from typing import Any

EXTREMES: tuple[Any, ...] = (
    0, -1, 1, 255, 65536, 2**31 - 1, -(2**31), 2**63, 10**40, -0.0, 0.5, 1e-300, 1e300, -1e300,
    float("nan"), float("inf"), "", "0", "x", "\u0000", "../..", "z" * 300, None, True, False,
    [], {}, [[]], [None], [1e300] * 3, [0, 0, 0], {"a": 1}, [[1, 2], [3]],
)  # fmt: skip
WORDS = (
    b"", b"0", b"-1", b"nan", b"inf", b"1e999", b"4294967296", b"99999999999999999999", b"-0",
    b"x", b"\xff\xfe", b"\0", b"1,5", b"list", b"element", b"property", b"end_header", b"1/2/3",
)  # fmt: skip


def bytes_mutated(content: bytes, random: Random) -> bytes:
    """Harm bytes in one of many ways, up to three times."""
    for _ in range(random.choice((1, 1, 2, 3))):
        content = random.choice(
            (_cut, _flip, _flip, _extreme, _extreme, _moved, _removed, _repeated, _noise)
        )(content, random)
    return content


def text_mutated(content: bytes, random: Random) -> bytes:
    """Harm words and lines of a text, or its bytes."""
    if random.random() < 0.3:
        return bytes_mutated(content, random)
    end = content.find(b"end_header")
    head = content if end < 0 or random.random() < 0.5 else content[:end]
    words = head.split(b" ")
    for _ in range(random.choice((1, 2))):
        place, other = random.randrange(len(words)), random.randrange(len(words))
        kind = random.randrange(4)
        if kind == 0:
            words[place] = random.choice(WORDS)
        elif kind == 1:
            words[place], words[other] = words[other], words[place]
        elif kind == 2:
            words.insert(place, random.choice(WORDS))
        elif len(words) > 1:
            del words[place]
    return b" ".join(words) + content[len(head) :]


def json_mutated(content: bytes, random: Random) -> bytes:
    """Harm values and keys of JSON, or its bytes."""
    if random.random() < 0.2:
        return bytes_mutated(content, random)
    tree = copy.deepcopy(json.loads(content))
    for _ in range(random.choice((1, 1, 2))):
        tree = tree_mutated(tree, random)
    return json.dumps(tree).encode()


def tree_mutated(tree: Any, random: Random) -> Any:
    """Harm one place of a tree of lists and objects."""
    spots = list(_spots(tree))
    if not spots:
        return random.choice(EXTREMES)
    node, key = random.choice(spots)
    other, far = random.choice(spots)
    kind = random.randrange(7)
    if kind <= 2:
        node[key] = random.choice(EXTREMES)
    elif kind == 3:
        node[key], other[far] = copy.deepcopy(other[far]), copy.deepcopy(node[key])
    elif kind == 4:
        del node[key]
    elif kind == 5 and isinstance(node, dict):
        node[random.choice(("x", "version", "type", str(key).upper()))] = node.pop(key)
    elif isinstance(node, list):
        node.insert(key, copy.deepcopy(random.choice((other[far], *EXTREMES))))
    return tree


def _spots(tree: Any) -> Any:
    pairs = tree.items() if isinstance(tree, dict) else enumerate(tree) if _is_list(tree) else ()
    for key, value in list(pairs):
        yield tree, key
        yield from _spots(value)


def _is_list(value: Any) -> bool:
    return isinstance(value, list)


def _cut(content: bytes, random: Random) -> bytes:
    return content[: random.randrange(len(content) + 1)]


def _flip(content: bytes, random: Random) -> bytes:
    out = bytearray(content)
    for _ in range(random.choice((1, 1, 4, 16))):
        if out:
            # Headers are short and say the most.
            reach = len(out) if random.random() < 0.5 else min(len(out), 400)
            out[random.randrange(reach)] ^= 1 << random.randrange(8)
    return bytes(out)


def _extreme(content: bytes, random: Random) -> bytes:
    out = bytearray(content)
    size = random.choice((1, 2, 4, 8))
    if len(out) >= size:
        reach = len(out) if random.random() < 0.5 else min(len(out), 400)
        place = random.randrange(max(1, reach - size + 1))
        fill = random.choice((b"\0", b"\xff", b"\x7f", b"\x80"))
        out[place : place + size] = random.choice((fill * size, b"\0" * (size - 1) + fill))
    return bytes(out)


def _moved(content: bytes, random: Random) -> bytes:
    if not content:
        return content
    size = random.randrange(1, 1 + min(64, len(content)))
    first = random.randrange(len(content) - size + 1)
    second = random.randrange(len(content) - size + 1)
    out = bytearray(content)
    out[first : first + size] = content[second : second + size]
    return bytes(out)


def _removed(content: bytes, random: Random) -> bytes:
    first = random.randrange(len(content) + 1)
    return content[:first] + content[first + random.randrange(1, 40) :]


def _repeated(content: bytes, random: Random) -> bytes:
    first = random.randrange(len(content) + 1)
    part = content[first : first + random.randrange(1, 40)]
    return content[:first] + part * random.choice((1, 3)) + content[first:]


def _noise(content: bytes, random: Random) -> bytes:
    first = random.randrange(len(content) + 1)
    return content[:first] + random.randbytes(random.randrange(1, 12)) + content[first:]
