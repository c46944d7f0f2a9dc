"""A client of an OpenXR runtime, from the documented record and the specification's frames alone.

Frames: z towards the wrist, y out of the back of the hand. Nothing here is shared with the reader.
"""

import json
import zlib

import numpy as np

FINGERS = ["thumb", "index", "middle", "ring", "little"]
LENGTHS = {"thumb": [0.045, 0.033, 0.028]} | {finger: [0.065, 0.042, 0.025, 0.02] for finger in FINGERS[1:]}


def turn(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    matrix = np.eye(3)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    matrix[j, j] = matrix[k, k] = c
    matrix[k, j], matrix[j, k] = s, -s
    return matrix


def xyzw(matrix: np.ndarray) -> list[float]:
    """Quaternion of a rotation, by the eigenvector of Bar-Itzhack's matrix."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    k = np.array(
        [
            [a - e - i, d + b, g + c, h - f],
            [d + b, e - a - i, h + f, c - g],
            [g + c, h + f, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    return np.linalg.eigh(k / 3)[1][:, -1].tolist()


def joints(angles: dict[str, float], hand: str = "right", wrist: np.ndarray | None = None, place=(0, 1.2, -0.3)):
    """26 rows of position and orientation, for flexions and abductions [rad] by name."""
    wrist = np.eye(3) if wrist is None else wrist
    place, mirror = np.array(place, float), 1.0 if hand == "right" else -1.0
    rows = [[*(place + wrist @ [0, 0, -0.05]), *xyzw(wrist)], [*place, *xyzw(wrist)]]
    for k, finger in enumerate(FINGERS):
        # The right thumb is on the left.
        at = place + wrist @ [mirror * (0.012 * k - 0.03), 0, -0.02]
        frame = wrist
        if finger == "thumb":
            # Flexion and palmar abduction of the metacarpal both turn about x, towards the palm.
            frame = wrist @ turn(0, -angles.get("thumb abduction", 0.0))
            kinds = [None, "MP", "IP"]
        else:
            kinds = [None, "MP", "PIP", "DIP"]
        for kind, length in zip(kinds, LENGTHS[finger]):
            if kind == "MP" and finger != "thumb":
                # Towards the thumb for index and middle finger, away from it for the others; about y to the left.
                sign = mirror * (1 if finger in ("index", "middle") else -1)
                spread = sign * angles.get(f"{finger} abduction", 0.0)
                frame = frame @ turn(0, -angles.get(f"{finger} MP", 0.0)) @ turn(1, spread)
            elif kind is not None:
                frame = frame @ turn(0, -angles.get(f"{finger} {kind}", 0.0))
            rows.append([*at, *xyzw(frame)])
            at = at + frame @ [0, 0, -length]
        rows.append([*at, *xyzw(frame)])
    return [[float(value) for value in row] for row in rows]


def line(time: float, rows, hand: str = "right") -> bytes:
    text = json.dumps({"hand": hand, "time": time, "joints": rows}).encode()
    return b"%08x %s\n" % (zlib.crc32(text), text)
