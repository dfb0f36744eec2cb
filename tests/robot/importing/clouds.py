"""Files of a point cloud in every format that is read."""

import struct
from collections.abc import Callable, Mapping

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.sensor_data import encode_pcd


def pcd_ascii(points: Array) -> bytes:
    head = encode_pcd(points)[: encode_pcd(points).index(b"DATA")]
    return head + b"DATA ascii\n" + lines(points, " ").encode()


def pcd_compressed(points: Array) -> bytes:
    """Columns after each other in LZF: some bytes as they are, and runs that refer back."""
    head = encode_pcd(points)[: encode_pcd(points).index(b"DATA")]
    raw = np.asarray(points, "<f4").T.tobytes()
    packed, at = bytearray(), 0
    while at < len(raw):
        length = 0
        while at >= 8 and at + length < len(raw) and length < 264 and raw[at + length] == raw[at + length - 8]:
            length += 1
        if length >= 3:
            code = length - 2
            packed += bytes([code << 5, 7]) if code < 7 else bytes([7 << 5, code - 7, 7])
            at += length
        else:
            packed += bytes([0, raw[at]])
            at += 1
    return head + b"DATA binary_compressed\n" + struct.pack("<II", len(packed), len(raw)) + packed


def ply(points: Array, kind: str) -> bytes:
    head = f"""ply
format {kind} 1.0
comment by a test
element vertex {len(points)}
property uchar ring
property double x
property double y
property float z
element face 0
property list uchar int vertex_index
end_header
"""
    if kind == "ascii":
        return head.encode() + "".join(f"3 {x} {y} {z}\n" for x, y, z in points).encode()
    order = ">" if kind.endswith("big_endian") else "<"
    return head.encode() + b"".join(struct.pack(f"{order}Bddf", 3, *point) for point in points)


def lines(points: Array, separator: str) -> str:
    return "".join(separator.join(f"{value:.9g}" for value in point) + "\n" for point in points)


def las(points: Array, minor: int, format_: int) -> bytes:
    """A LAS file of version 1.minor, with 40 bytes a point and a resolution of 10 um."""
    size = 375 if minor == 4 else 227
    scale, origin = 1e-5, np.round(points.mean(0))
    head = bytearray(size)
    head[:4], head[24:26] = b"LASF", bytes([1, minor])
    struct.pack_into("<HI", head, 94, size, size)
    struct.pack_into("<BHI", head, 104, format_, 40, 0 if minor == 4 else len(points))
    struct.pack_into("<6d", head, 131, *[scale] * 3, *origin)
    if minor == 4:
        struct.pack_into("<Q", head, 247, len(points))
    whole = np.round((points - origin) / scale).astype("<i4")
    return bytes(head) + b"".join(row.tobytes() + bytes(28) for row in whole)


CLOUDS: Mapping[str, Callable[[Array], bytes]] = {
    "binary.pcd": encode_pcd,
    "ascii.pcd": pcd_ascii,
    "compressed.pcd": pcd_compressed,
    "ascii.ply": lambda points: ply(points, "ascii"),
    "little.ply": lambda points: ply(points, "binary_little_endian"),
    "big.ply": lambda points: ply(points, "binary_big_endian"),
    "blanks.xyz": lambda points: lines(points, " ").encode(),
    "titled.csv": lambda points: ("ring,x,y,z\n" + lines(np.insert(points, 0, 1.0, 1), ",")).encode(),
    "counted.pts": lambda points: f"{len(points)}\n{lines(points, ' ')}".encode(),
    "commented.txt": lambda points: ("# by a test\n" + lines(points, "\t")).encode(),
    "old.las": lambda points: las(points, 0, 0),
    "new.LAS": lambda points: las(points, 4, 10),
}
"""Files by a name with their ending."""
