"""The child process of `structure`: runs pycolmap, and nothing that loads Pillow beside it.

Called with one argument, JSON: folder `images`, names of files in it by their `cameras`, folder
`output` for models, file `database`, and whether the photos are `ordered` as those of a video.
Lines for the user begin with "pcore: ".
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from pcore.capture.upright import upright

_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
_PAIRS = 150
"""Photos up to which every pair is matched."""
_SIDE = 1600
"""Pixels of the longer side in which features are looked for."""


def main(wish: dict[str, Any]) -> None:
    """Find features, match them, map; write every model that has images."""
    import pycolmap

    cameras: list[list[str]] = wish["cameras"]
    count = sum(map(len, cameras))
    output, database = Path(wish["output"]), str(wish["database"])
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.max_image_size = _SIDE
    _say(f"features of {count} photos; {len(cameras)} cameras by folder, size and EXIF")
    for names in cameras:
        # Left alone, COLMAP gives every photo without EXIF a lens of its own.
        pycolmap.extract_features(
            database,
            wish["images"],
            names,
            camera_mode=pycolmap.CameraMode.SINGLE,
            extraction_options=extraction,
        )
    ordered = wish["ordered"] and count > _PAIRS
    _say("matching " + ("neighbours" if ordered else "all pairs"))
    (pycolmap.match_sequential if ordered else pycolmap.match_exhaustive)(database)
    _say("finding poses")
    output.mkdir(parents=True, exist_ok=True)
    done = 0

    def next_image() -> None:
        nonlocal done
        done += 1
        if done % 10 == 0:
            _say(f"finding poses: {done} photos")

    models = pycolmap.incremental_mapping(
        database, wish["images"], str(output), next_image_callback=next_image
    )
    for number, model in models.items():
        _stand(model)
        model.write(str(output / str(number)))
    sizes = sorted((model.num_reg_images() for model in models.values()), reverse=True)
    _say(f"models of {', '.join(map(str, sizes)) or 'no'} photos")


def _stand(model: Any) -> None:
    """Give a model an upright world: nobody has chosen the one that it is in."""
    import pycolmap

    numbers = sorted(model.reg_image_ids(), key=lambda number: model.images[number].name)
    poses = [
        np.vstack([model.images[number].cam_from_world().inverse().matrix(), [0, 0, 0, 1]])
        for number in numbers
    ]
    found = upright(np.stack(poses) @ _OPENGL)
    turn = pycolmap.Rotation3d(found.rotation)
    model.transform(pycolmap.Sim3d(found.scale, turn, found.translation))


def _say(line: str) -> None:
    sys.stdout.write(f"pcore: {line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
