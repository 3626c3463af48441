"""What a file is by its first bytes, for messages about files that hold something else."""

from __future__ import annotations

_BEGINNINGS = (
    (b"version https://git-lfs", "a pointer of Git LFS; fetch the file itself with `git lfs pull`"),
    (b"ply", "a PLY file"),
    (b"glTF", "a binary glTF file (.glb)"),
    (b"\x93NUMPY", "a NumPy array (.npy)"),
    (b"PK\x03\x04", "a ZIP archive, which .npz, .usdz and newer PyTorch files are"),
    (b"\x1f\x8b", "a file that is compressed with gzip; unpack it first"),
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (b"Kaydara FBX", "an FBX file, which is not read; export .ply, .obj or .glb"),
    (b"BLENDER", "a Blender file, which is not read; export .ply, .obj or .glb"),
    (b"NGSP", "a Gaussian splat in SPZ form, which is not read; export a .ply"),
    (b"solid ", "an STL file, which is not read; export .ply, .obj or .glb"),
    (b"# .PCD", "a PCD file of PCL, which is not read; convert it to .ply (pcl_pcd2ply)"),
    (b"LASF", "a LAS file, which is not read; convert it to .ply"),
    (b"<", "markup such as an HTML page; was the download refused?"),
    (b"{", "JSON text"),
)


def kind_of(content: bytes) -> str | None:
    """Name the format of a file by how it begins.

    Args:
        content: the file, or its first bytes.

    Returns:
        What it is, with what to do where that is known; None when nothing known begins so.
    """
    if not content:
        return "an empty file"
    head = content[:64].lstrip(b"\xef\xbb\xbf \t\r\n")
    return next((what for start, what in _BEGINNINGS if head.startswith(start)), None)
