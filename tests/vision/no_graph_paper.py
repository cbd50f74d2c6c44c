"""Pictures that are not of graph paper, as they may be photographed by mistake."""

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]

SIZE = (1280, 720)
_FLAT = (1600, 1200)


def photograph(
    flat: NDArray[np.float64], seed: int = 0, tilt: float = 0.15, turn_deg: float = 4.0
) -> Picture:
    """Return a flat drawing (1200, 1600) as a camera sees it: turned, slanted, blurred, noisy, unevenly lit."""
    width, height = SIZE
    turn = np.deg2rad(turn_deg)
    spin = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    corners = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]) * (
        0.5 * _FLAT[0],
        0.5 * _FLAT[1],
    )
    seen = corners @ spin.T
    seen /= 1.0 + tilt * seen[:, 1:] / _FLAT[1]
    way = cv2.getPerspectiveTransform(
        np.add(corners, (0.5 * _FLAT[0], 0.5 * _FLAT[1])).astype(np.float32),
        np.add(seen, (width / 2, height / 2)).astype(np.float32),
    )
    picture = cv2.warpPerspective(flat, way, SIZE, flags=cv2.INTER_AREA, borderValue=60.0)
    picture = cv2.GaussianBlur(picture, (0, 0), 0.8)
    v, u = np.mgrid[:height, :width]
    light = 1.0 - 0.25 * ((u / width - 0.4) ** 2 + (v / height - 0.3) ** 2)
    noisy = picture * light + np.random.default_rng(seed).normal(0.0, 2.5, picture.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def _blank() -> NDArray[np.float64]:
    return np.full((_FLAT[1], _FLAT[0]), 225.0)


def draw_lined_paper() -> Picture:
    """Return exercise paper: lines in one direction and a margin."""
    flat = _blank()
    for v in range(40, _FLAT[1], 32):
        cv2.line(flat, (0, v), (_FLAT[0], v), 150.0, 2)
    cv2.line(flat, (300, 0), (300, _FLAT[1]), 120.0, 2)
    return photograph(flat)


def draw_chessboard(square_px: int = 40) -> Picture:
    """Return a chessboard that fills the picture."""
    rows, columns = np.mgrid[: _FLAT[1], : _FLAT[0]]
    return photograph(50.0 + 170.0 * ((rows // square_px + columns // square_px) % 2))


def draw_keyboard(offsets: tuple[int, ...] = (0, 46, 70, 116)) -> Picture:
    """Return a keyboard: rows of keys with offsets [px] in turn, with letters, wider keys at the ends."""
    random = np.random.default_rng(3)
    flat = np.full((_FLAT[1], _FLAT[0]), 40.0)
    key = 92
    for row in range(11):
        left = 40 + offsets[row % len(offsets)]
        for column in range(15):
            wide = 60 if column in {0, 14} else 0
            u, v = left + column * (key + 8), 60 + row * (key + 8)
            cv2.rectangle(flat, (u, v), (u + key + wide, v + key), 85.0, -1)
            letter = chr(int(random.integers(65, 91)))
            cv2.putText(flat, letter, (u + 20, v + 50), cv2.FONT_HERSHEY_SIMPLEX, 1.2, 220.0, 3)
            left += wide
    return photograph(flat)
