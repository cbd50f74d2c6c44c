"""Whether a stated distance between lines agrees with the sheet: its heavier lines, and lines too fine to see.

No residual shows a wrong multiple: if 10 mm lines are counted as 1 mm lines, everything is ten times too small and fits
perfectly. Paper has heavier lines every 5 or 10 mm (ISO sizes) or every half inch or inch, so their rhythm contradicts
a wrong pitch. Plain lines have no rhythm. They are taken for the finest lines if finer ones would be seen, if the sheet
would otherwise be larger than any sheet, or if they are as thick for their distance as only fine lines are. Thick lines
may be a pen's, drawn over finer ones: that has to be excluded by the picture itself.
"""

import numpy as np

from labrig.vision.graph_paper import Crossings
from labrig.vision.ruling import Rhythm

# Distances of heavier lines [mm]: metric paper, and paper in inches (a quarter, a half, one).
_HEAVY_MM = (5.0, 10.0, 6.35, 12.7, 25.4)
_TOLERANCE = 0.01
_ORDINALS = {2: "2nd", 3: "3rd"}
# The largest sheets [mm], and the thickest lines every 5 or 10 of the finest: their width over their distance, times
# their density. Lines every 5 mm of paper for electrocardiograms have 0.03 to 0.05, on sheets of A2 at the most; lines
# every 10 mm are thinner for their distance, on sheets up to A0.
_LARGEST_SHEET_MM = {5: (594.0, 420.0), 10: (1189.0, 841.0)}
_THICKEST = {5: 0.05, 10: 0.02}
# Lines with heavier ones every 5 mm, all alike, could be drawn over every second line of paper with heavier ones every
# 10 mm. Lines so far apart [px] show what is between them.
_LEAST_ALIKE_PX = 8.0
# A known scale tells one multiple from another: they differ by two or more.
_SAME_SCALE = 1.3


def judge_pitch(found: Crossings, pitch_mm: float, known_pitch_px: float | None = None) -> list[str]:
    """Return why a stated pitch is refused: the sheet's lines contradict it, or do not tell which lines they are.

    Parameters
    ----------
    pitch_mm : float
        Stated distance of the finest lines.
    known_pitch_px : float, optional
        That distance in the picture by an earlier map of the same camera, which settles what the picture leaves open.
    """
    reasons = _judge_rhythm(found, pitch_mm)
    if known_pitch_px is not None and 1.0 / _SAME_SCALE < found.pitch_px / known_pitch_px < _SAME_SCALE:
        return reasons
    reasons += _judge_alike(found, pitch_mm)
    ruling = found.ruling
    size_mm = np.sort(np.ptp(found.indices, axis=0) * pitch_mm)[::-1]
    open_to = [
        number
        for number in (ruling.unresolved if ruling.rhythm is None else ())
        if number in _LARGEST_SHEET_MM
        and _is_heavy(number * pitch_mm)
        and (number * size_mm <= _LARGEST_SHEET_MM[number]).all()
        and ruling.thickness < _THICKEST[number]
    ]
    if open_to:
        reasons.append(
            f"the lines {found.pitch_px:.1f} px apart show no heavier ones: they could be {pitch_mm:g} mm apart, or "
            f"{open_to[0] * pitch_mm:g} mm with finer lines between them that the picture does not show: "
            "come closer, or use paper with heavier lines every 5 or 10 mm"
        )
    if ruling.undecided:
        between = "a fainter one" if ruling.undecided[0] == 2 else f"{ruling.undecided[0] - 1} fainter ones"
        reasons.append(
            f"the lines {found.pitch_px:.1f} px apart are too blurred to tell whether there would be {between} between "
            "any two: focus the camera, come closer, or use paper with heavier lines every 10 mm"
        )
    return reasons


def _judge_alike(found: Crossings, pitch_mm: float) -> list[str]:
    """Return why lines are refused that could be every second of the paper's: heavier ones at twice the distance."""
    rhythm = found.ruling.rhythm
    if rhythm is None or rhythm.heavy != rhythm.heaviest or found.pitch_px >= _LEAST_ALIKE_PX:
        return []
    heavy_mm = rhythm.heavy * pitch_mm
    if not (_is_heavy(heavy_mm) and _is_heavy(2.0 * heavy_mm)):
        return []
    reason = (
        f"the lines {found.pitch_px:.1f} px apart have heavier ones every {heavy_mm:.4g} mm, all alike: they could be "
        f"drawn over every second line of paper with heavier ones every {2.0 * heavy_mm:.4g} mm: come closer until "
        f"they are {_LEAST_ALIKE_PX:g} px apart, or use paper whose every 10th line is the heaviest"
    )
    return [reason]


def _judge_rhythm(found: Crossings, pitch_mm: float) -> list[str]:
    rhythm = found.ruling.rhythm
    if rhythm is None:
        return []
    wrong = next(
        (every for every in (rhythm.heavy, rhythm.heaviest) if not _is_heavy(every * pitch_mm)), None
    )
    if wrong is None:
        return []
    counted = f"every {_ORDINALS.get(wrong, f'{wrong}th')} line is heavier"
    implied = f"with lines {pitch_mm:g} mm apart that would be every {wrong * pitch_mm:.4g} mm"
    fitting = _list_fitting(rhythm, wrong)
    return [f"{counted}: {implied}, and paper has heavier lines every 5 or 10 mm: {_suggest(found, fitting)}"]


def _list_fitting(rhythm: Rhythm, every: int) -> list[float]:
    """Return the pitches [mm] that fit all heavier lines, or if none does, those every `every` lines."""
    near = [heavy / every for heavy in (5.0, 10.0)]
    fitting = [
        pitch for pitch in near if _is_heavy(rhythm.heavy * pitch) and _is_heavy(rhythm.heaviest * pitch)
    ]
    return fitting or near


def _suggest(found: Crossings, pitches_mm: list[float]) -> str:
    fitting = " or ".join(f"{pitch:.3g}" for pitch in pitches_mm)
    closer = ", or come closer until finer lines are seen" if found.ruling.hidden == 1 else ""
    return (
        f"the lines counted are {found.pitch_px:.1f} px apart: measure them; {fitting} mm would fit{closer}"
    )


def _is_heavy(distance_mm: float) -> bool:
    return any(abs(distance_mm / heavy - 1.0) < _TOLERANCE for heavy in _HEAVY_MM)
