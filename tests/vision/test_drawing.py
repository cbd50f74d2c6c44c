"""The plan in its picture: each part is drawn in its colour, where the plane's map puts it."""

import numpy as np
import pytest

from labrig.protocol.model import Direction
from labrig.vision.drawing import DrawnPlan, draw_plan
from labrig.vision.plane import PlaneMap

PX_PER_MM = 5.0
# Blue, green, red, as the page's legend names them.
PATH, TARGET, OBSTACLE, AXES, SHEATH = (
    (233, 180, 86), (0, 94, 213), (66, 228, 240), (115, 158, 0), (167, 121, 204),
)  # fmt: skip


@pytest.mark.parametrize("insertion", ["right", "up"])
def test_each_part_is_drawn_where_the_plane_puts_it(insertion: Direction) -> None:
    """Points are (y, z): the path leads along z, the target is aside of it by its y, and so are ring and obstacle."""
    plane = PlaneMap.from_scale(PX_PER_MM, (200.0, 200.0), insertion)
    path_mm, obstacles = np.array([(-2.0, 5.0), (-2.0, 25.0)]), (((-10.0, 12.0), 3.0),)
    plan = DrawnPlan(path_mm, (6.0, 20.0), 2.0, obstacles, ((-15.0, 0.0), 0.0))
    image = np.full((400, 400), 90, np.uint8)
    drawn = draw_plan(image, plane, plan)

    def has(colour: tuple[int, int, int], place_mm: tuple[float, float]) -> bool:
        u, v = np.rint(plane.to_px(np.array([place_mm]))[0]).astype(int)
        seen = drawn[v - 1 : v + 2, u - 1 : u + 2].reshape(-1, 3).astype(float)
        # The lines are smoothed: a pixel of one is nearer to its colour than to the grey below.
        return bool(np.any(np.linalg.norm(seen - colour, axis=1) < np.linalg.norm(seen - 90.0, axis=1)))

    assert has(PATH, (-2.0, 15.0))
    assert not has(PATH, (15.0, -2.0))
    assert has(TARGET, (6.0 + 2.0, 20.0))
    assert has(OBSTACLE, (-10.0, 12.0 + 3.0))
    assert has(AXES, (0.0, 9.0))
    assert has(AXES, (9.0, 0.0))
    assert count_written(drawn, plane, (0.0, 10.0)) > 1.5 * count_written(drawn, plane, (10.0, 0.0))
    assert has(SHEATH, (-15.0, 20.0))
    assert not has(SHEATH, (5.0, 0.0))
    assert image.max() == 90


def count_written(drawn: np.ndarray, plane: PlaneMap, end_mm: tuple[float, float]) -> int:
    """Return how many pixels right of an axis' end are green: `z 10 mm` is longer than `y`."""
    u, v = np.rint(plane.to_px(np.array([end_mm]))[0]).astype(int)
    seen = drawn[v - 15 : v + 16, u + 3 : u + 90].astype(int)
    return int(np.count_nonzero(seen[..., 1] - seen[..., 2] > 40))
