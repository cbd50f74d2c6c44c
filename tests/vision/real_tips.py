"""The tips of all 85 frames of the shared real insertions, marked twice by eye.

`marks/real_tips.csv` holds pixels of the original frame, read by one observer off crops enlarged six times. The
observer went through the frames twice, in two shuffled orders and with other crops, the second time without the marks
of the first, both before labrig measured these frames again. A mark is where the darkness of the shaft has faded by
half. The two marks of a frame are apart by 0.54 px (median), 1.22 px (95 %) and 1.58 px (worst): 0.10, 0.22 and
0.28 mm.

The needles are nearly straight: these frames test the tip and no radius.
"""

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

PICTURES = Path(__file__).parents[2].parent / "shared" / "data" / "real_insertions"
_MARKS = Path(__file__).parent / "marks" / "real_tips.csv"


@dataclass(frozen=True)
class MarkedTip:
    """The two marks (u, v) [px] of the tip in a frame of a trial, and the frame's file."""

    trial: str
    frame: int
    marks_px: NDArray[np.float64]

    @property
    def picture(self) -> Path:
        """Return the frame's file."""
        return PICTURES / self.trial / f"ImgFeedback{self.frame}.jpg"

    @property
    def mean_px(self) -> NDArray[np.float64]:
        """Return the mean of the two marks."""
        return np.asarray(self.marks_px.mean(axis=0))

    @property
    def spread_px(self) -> float:
        """Return the distance between the two marks."""
        return math.dist(*self.marks_px)


def read_marked_tips() -> list[MarkedTip]:
    """Return the marks of all frames, in the order of trials and frames."""
    with _MARKS.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))[1:]
    return [MarkedTip(trial, int(frame), np.array(px, float).reshape(2, 2)) for trial, frame, *px in rows]
