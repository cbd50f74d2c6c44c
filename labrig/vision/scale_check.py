"""Whether a new plane map agrees with the last one of the same camera: a wrong multiple of the scale shows at once."""

from labrig.vision.plane import PlaneMap

# Wrong multiples: a heavier line, or every second line, counted as the finest; within this share of it.
_MULTIPLES = (2.0, 5.0, 10.0)
_TOLERANCE = 0.05


def compare_scales(plane: PlaneMap, last: PlaneMap) -> tuple[str, bool]:
    """Return how the scale changed since the last map, in a sentence, and whether it looks like a wrong multiple."""
    ratio = plane.mm_per_px / last.mm_per_px
    if plane.picture_mm is None or plane.image_size != last.image_size:
        return (
            "The last plane map of this rig is for pictures of another size; the scales are not compared.",
            False,
        )
    width = plane.picture_mm[0]
    was = f"By the last plane map of this rig it was {width / ratio:.0f} mm wide"
    multiple = next(
        (number for number in _MULTIPLES if abs(max(ratio, 1.0 / ratio) / number - 1.0) < _TOLERANCE), None
    )
    if multiple is None:
        return f"{was}: {100.0 * abs(ratio - 1.0):.1f} % {'less' if ratio > 1.0 else 'more'}.", False
    return f"{was}: a {'smaller' if ratio > 1.0 else 'larger'} view by a factor of {multiple:g}.", True
