"""Decode one compressed file of Gaussians from standard input; see `compressed_gaussians`.

A program of its own, which knows nothing of pcore: the decoder is native code and reads files that
strangers made. What it does wrong ends this process only, and what it prints is not ours.
"""

from __future__ import annotations

import json
import os
import sys
from typing import Any

_ARRAYS = ("positions", "scales", "rotations", "alphas", "colors", "sh")


def main() -> None:
    """Write a line of JSON (a length for each array, the degree; or an error), then the arrays."""
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    import gaussforge  # pyright: ignore[reportMissingImports]

    content, forge = sys.stdin.buffer.read(), gaussforge.GaussForge()
    found: dict[str, Any] = forge.read(content, sys.argv[1])
    if found.get("error") == "std::bad_cast":
        # So its `read` ends for all Gaussians without harmonics; its `convert` does not.
        found = forge.convert(content, sys.argv[1], "ply")
        if not found.get("data"):
            found = {"error": "it holds no Gaussians"}
    if "error" in found:
        answer.write(json.dumps({"error": str(found["error"])}).encode() + b"\n")
    elif isinstance(found["data"], bytes):
        answer.write(b'{"ply": true}\n' + found["data"])
    else:
        data: dict[str, Any] = found["data"]
        arrays = [bytes(data.get(name) or b"") for name in _ARRAYS]
        head = {"count": data["numPoints"], "degree": data["meta"]["shDegree"]}
        sizes = dict(zip(_ARRAYS, map(len, arrays), strict=True))
        answer.write(json.dumps(head | {"sizes": sizes}).encode() + b"\n")
        answer.write(b"".join(arrays))
    answer.close()


if __name__ == "__main__":
    main()
