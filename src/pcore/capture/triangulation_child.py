"""The child process of `triangulation`: runs pycolmap, and nothing that loads Pillow beside it.

Called with one argument, JSON: folder `images` of straight pictures, folder `masks` (NAME.png of a
picture NAME, 0 where there is nothing to look at), `cameras` (name, width, height, fx, fy, cx, cy
and the rows of `camera_from_world`, OpenCV axes), `pairs` of names, folder `output` for the model
and file `agreement` for the pairs: numbers of two cameras, how many features match by pictures
alone, and how far from the line of the other's pose the middle one lies, pixels. Lines for the user
begin with "pcore: ".
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def main(wish: dict[str, Any]) -> None:
    """Match features, hold the matches against the poses, and triangulate what agrees."""
    import pycolmap

    work, cameras = Path(wish["output"]), wish["cameras"]
    database = str(work / "database.db")
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model, reader.mask_path = "PINHOLE", wish["masks"]
    _say(f"looking for features in {len(cameras)} photos")
    pycolmap.extract_features(
        database,
        wish["images"],
        [one["name"] for one in cameras],
        camera_mode=pycolmap.CameraMode.PER_IMAGE,
        reader_options=reader,
    )
    model = pycolmap.Reconstruction()
    with pycolmap.Database.open(database) as stored:
        images = {image.name: image for image in stored.read_all_images()}
        for one in cameras:
            image = images[one["name"]]
            camera = stored.read_camera(image.camera_id)
            camera.params = [one[key] for key in ("fx", "fy", "cx", "cy")]
            camera.has_prior_focal_length = True
            stored.update_camera(camera)
            model.add_camera_with_trivial_rig(camera)
            pose = pycolmap.Rigid3d(np.array(one["camera_from_world"]))
            model.add_image_with_trivial_frame(image, pose)
    listed = work / "pairs.txt"
    listed.write_text("".join(f"{first} {second}\n" for first, second in wish["pairs"]))
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = str(listed)
    _say(f"matching {len(wish['pairs'])} pairs")
    pycolmap.match_image_pairs(database, pairing_options=pairing)
    ids = {images[one["name"]].image_id: number for number, one in enumerate(cameras)}
    np.save(wish["agreement"], _agreement(database, ids, cameras))
    _say("placing points")
    found = pycolmap.triangulate_points(model, database, wish["images"], str(work))
    _say(f"{found.num_points3D()} points")


def _agreement(database: str, ids: dict[int, int], cameras: list[dict[str, Any]]) -> Floats:
    """Rows (P, 4): two numbers of cameras, matches, median distance from the line in pixels."""
    import pycolmap

    rows: list[tuple[float, ...]] = []
    with pycolmap.Database.open(database) as stored:
        places = {
            one: stored.read_keypoints(one)[:, :2].astype(float)
            for one in ids
            if stored.exists_keypoints(one)
        }
        for key, pair in zip(*stored.read_two_view_geometries(), strict=True):
            first, second = pycolmap.pair_id_to_image_pair(key)
            matches = np.asarray(pair.inlier_matches)
            if len(matches):
                a, b = places[first][matches[:, 0]], places[second][matches[:, 1]]
                off = from_line(a, b, cameras[ids[first]], cameras[ids[second]])
                rows.append((ids[first], ids[second], len(matches), float(np.median(off))))
    return np.array(rows).reshape(-1, 4)


def from_line(a: Floats, b: Floats, one: dict[str, Any], other: dict[str, Any]) -> Floats:
    """How far (M,) places in two pictures (M, 2) are from a common point of space, pixels.

    To first order (Sampson; Hartley and Zisserman, 11.4.3).
    """
    first, second = np.array(one["camera_from_world"]), np.array(other["camera_from_world"])
    turn = second[:, :3] @ first[:, :3].T
    x, y, z = second[:, 3] - turn @ first[:, 3]
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ turn
    fundamental = np.linalg.inv(_pinhole(other)).T @ essential @ np.linalg.inv(_pinhole(one))
    a, b = (np.concatenate([places, np.ones((len(places), 1))], axis=1) for places in (a, b))
    in_second, in_first = a @ fundamental.T, b @ fundamental
    steep = (in_second[:, :2] ** 2).sum(axis=1) + (in_first[:, :2] ** 2).sum(axis=1)
    return np.abs((b * in_second).sum(axis=1)) / np.sqrt(np.maximum(steep, 1e-30))


def _pinhole(camera: dict[str, Any]) -> Floats:
    return np.array([[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1.0]])


def _say(line: str) -> None:
    sys.stdout.write(f"pcore: {line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(json.loads(Path(sys.argv[1]).read_text()))
