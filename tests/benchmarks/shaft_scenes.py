"""Needles among walls, wide sheaths, gel edges and other shafts: how many are right, refused and wrong.

`python -m tests.benchmarks shaft-scenes`; the number of pictures of each kind is `LABRIG_BENCHMARK_SCENES`, 60 unless
set. The renderer is `tests/vision/gel_scenes.py`, which shares no code with labrig. The finder was built with other
seeds in view (below 1060). Right is: tip within 1 mm, sheath's tip within 0.5 mm, 95 % of the centre line within
0.1 mm. Everything else that is found is wrong. All tips lie in the picture.
"""

import os
import re
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from typing import Any

import cv2
import numpy as np
from numpy.random import Generator
from scipy.spatial import cKDTree

from labrig.errors import MeasurementRefusedError
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft import Shaft, locate_shaft
from tests.benchmarks.table import print_rows
from tests.vision.gel_scenes import Background, Scene, SceneBar, SceneNeedle

SCENES = int(os.environ.get("LABRIG_BENCHMARK_SCENES", "60"))
FIRST_SEED = 2000
SIZE_MM = (87.0, 49.0)
# A tip this close to the border is drawn anew.
LEAST_MARGIN_MM = 3.0
TIP_MM, ENTRY_MM, LINE_MM = 1.0, 0.5, 0.1
REASONS = 4


@dataclass(frozen=True)
class Outcome:
    """What became of a picture: the errors [mm] of tip, sheath's tip and centre line (95 %), or the refusal."""

    errors_mm: tuple[float, float, float] | None
    reason: str = ""

    @property
    def verdict(self) -> str:
        """Return right, refused or wrong."""
        if self.errors_mm is None:
            return "refused"
        good = all(
            error <= limit for error, limit in zip(self.errors_mm, (TIP_MM, ENTRY_MM, LINE_MM), strict=True)
        )
        return "right" if good else "wrong"


def print_table() -> None:
    """Print how many pictures of each kind are right, refused and wrong, and the commonest refusals."""
    cv2.setNumThreads(1)
    rows: list[list[object]] = []
    reasons: dict[str, Counter[str]] = {}
    with ProcessPoolExecutor(os.cpu_count(), get_context("fork")) as pool:
        for kind in KINDS:
            seeds = range(FIRST_SEED, FIRST_SEED + SCENES)
            outcomes = list(pool.map(partial(_measure_scene, kind), seeds, chunksize=5))
            rows.append([kind, *_summarize(outcomes)])
            reasons[kind] = Counter(
                re.sub(r"\d[\d.]*", "#", outcome.reason) for outcome in outcomes if outcome.errors_mm is None
            )
    print_rows(("kind", "right", "refused", "wrong", "tip mm: median", "95 %"), rows)
    for kind, counted in reasons.items():
        for reason, count in counted.most_common(REASONS):
            print(f"{kind}: {count} refused, {reason}")


def _summarize(outcomes: list[Outcome]) -> list[object]:
    counted = Counter(outcome.verdict for outcome in outcomes)
    tips = [outcome.errors_mm[0] for outcome in outcomes if outcome.errors_mm and outcome.verdict == "right"]
    spread = (f"{np.median(tips):.3f}", f"{np.percentile(tips, 95):.3f}") if tips else ("-", "-")
    return [counted["right"], counted["refused"], counted["wrong"], *spread]


def _measure_scene(kind: str, seed: int) -> Outcome:
    random = np.random.default_rng([list(KINDS).index(kind), seed])
    scene = KINDS[kind](random)
    while not _shows_tip(scene):
        scene = KINDS[kind](random)
    needle = _needle_of(scene)
    plane = PlaneMap.from_scale(scene.px_per_mm, (0.0, 0.0), "right")
    sheath_mm = None if needle.sheath_ratio is None else needle.sheath_ratio * needle.diameter_mm
    try:
        shaft = locate_shaft(scene.draw(), plane, needle.diameter_mm, sheath_mm)
    except MeasurementRefusedError as refusal:
        return Outcome(None, refusal.message)
    return Outcome(_errors_mm(shaft, scene, needle))


def _needle_of(scene: Scene) -> SceneNeedle:
    assert scene.needle is not None
    return scene.needle


def _shows_tip(scene: Scene) -> bool:
    margins = np.minimum(_needle_of(scene).tip_mm, np.array(SIZE_MM) - _needle_of(scene).tip_mm)
    return bool(margins.min() > LEAST_MARGIN_MM)


def _errors_mm(shaft: Shaft, scene: Scene, needle: SceneNeedle) -> tuple[float, float, float]:
    sheathed = needle.sheath_ratio is not None
    tip, entry = scene.px(np.array([needle.tip_mm, needle.sheath_tip_mm]))
    path = scene.px(needle.path_mm(np.linspace(0.0 if sheathed else -30.0, needle.length_mm, 4000)))
    away = np.percentile(cKDTree(path).query(shaft.centre_px)[0], 95)
    off_entry = float(np.hypot(*(shaft.entry_px - entry))) if sheathed else 0.0
    errors = np.array([np.hypot(*(shaft.tip_px - tip)), off_entry, away]) / scene.px_per_mm
    return float(errors[0]), float(errors[1]), float(errors[2])


def _draw_needle(random: Generator, **given: Any) -> SceneNeedle:
    radius_mm = random.uniform(22.0, 60.0)
    drawn = SceneNeedle(
        sheath_tip_mm=(random.uniform(8.0, 18.0), random.uniform(20.5, 28.5)),
        heading_rad=random.normal(0.0, 0.03),
        curvature_per_mm=random.choice((-1.0, 1.0)) / radius_mm,
        length_mm=random.uniform(18.0, min(45.0, 1.1 * radius_mm)),
        sheath_ratio=random.uniform(1.5, 1.8),
        level=random.uniform(45.0, 75.0),
        glint=random.uniform(0.0, 0.9),
    )
    return replace(drawn, **given)


def _draw_scene(random: Generator, needle: SceneNeedle, **given: Any) -> Scene:
    px_per_mm = random.uniform(7.0, 14.0)
    width_px, height_px = (round(side * px_per_mm) for side in SIZE_MM)
    return Scene(
        needle,
        width_px=width_px,
        height_px=height_px,
        px_per_mm=px_per_mm,
        gel_level=random.uniform(140.0, 185.0),
        unevenness=random.uniform(0.0, 0.4),
        blur_px=random.uniform(0.6, 1.3),
        noise=random.uniform(1.5, 5.0),
        seed=int(random.integers(1 << 30)),
        **given,
    )


def _draw_sheath(least: float, most: float, random: Generator) -> Scene:
    ratio, diameter_mm = random.uniform(least, most), random.uniform(0.7, 1.2)
    return _draw_scene(random, _draw_needle(random, sheath_ratio=ratio, diameter_mm=diameter_mm))


def _draw_bare(random: Generator) -> Scene:
    place = (random.uniform(3.0, 10.0), random.uniform(20.5, 28.5))
    return _draw_scene(random, _draw_needle(random, sheath_ratio=None, sheath_tip_mm=place))


def _draw_wall_across(random: Generator) -> Scene:
    """Draw a bright wall across a needle of 25 mm and more, with or without a sheath."""
    needle = _draw_needle(random, length_mm=random.uniform(25.0, 45.0))
    if random.random() < 0.5:
        needle = replace(needle, sheath_ratio=None, sheath_tip_mm=(5.0, needle.sheath_tip_mm[1]))
    z, y = needle.path_mm(np.array([random.uniform(0.15, 0.8) * needle.length_mm]))[0]
    width_mm, angle = random.uniform(1.0, 6.0), np.pi / 2.0 + random.normal(0.0, 0.08)
    level, opacity, soft = random.uniform(215.0, 250.0), random.uniform(0.7, 1.0), random.uniform(0.0, 0.8)
    wall = SceneBar((z, y), angle, width_mm, level, opacity, soft_mm=soft)
    shade = SceneBar((z - width_mm / 2.0 - 0.4, y), angle, 0.5, 70.0, 0.5)
    return _draw_scene(random, needle, above=(wall, shade) if random.random() < 0.5 else (wall,))


def _draw_wall_beside(levels: tuple[float, float], random: Generator) -> Scene:
    needle = _draw_needle(random)
    y = needle.sheath_tip_mm[1] + random.choice((-1.0, 1.0)) * random.uniform(5.0, 15.0)
    wall = SceneBar(
        (40.0, y), random.normal(0.0, 0.03), random.uniform(0.7, 4.0), random.uniform(*levels), 0.85
    )
    return _draw_scene(random, needle, below=(wall,))


def _draw_edge(before: Background, random: Generator) -> Scene:
    edge_mm = random.uniform(13.0, 32.0)
    place = (edge_mm + random.uniform(2.0, 10.0), random.uniform(20.5, 28.5))
    needle = _draw_needle(random, sheath_tip_mm=place, length_mm=random.uniform(18.0, 38.0))
    return _draw_scene(random, needle, edge_mm=edge_mm, edge_rad=random.normal(0.0, 0.05), before=before)


def _draw_wire(angles_rad: tuple[float, float], random: Generator) -> Scene:
    needle = _draw_needle(random, length_mm=random.uniform(25.0, 45.0))
    z, y = needle.path_mm(np.array([random.uniform(0.2, 0.9) * needle.length_mm]))[0]
    angle = random.choice((-1.0, 1.0)) * random.uniform(*angles_rad)
    width_mm = needle.diameter_mm * random.uniform(0.5, 1.4)
    return _draw_scene(random, needle, below=(SceneBar((z, y), angle, width_mm, random.uniform(45.0, 80.0)),))


def _draw_two_needles(random: Generator) -> Scene:
    """Draw two needles that cross; which of them is meant cannot be known, so each that is found counts as wrong."""
    needle = _draw_needle(random, length_mm=random.uniform(30.0, 45.0))
    z, y = needle.path_mm(np.array([random.uniform(0.3, 0.8) * needle.length_mm]))[0]
    angle, start = random.choice((-1.0, 1.0)) * random.uniform(0.2, 0.5), random.uniform(8.0, 14.0)
    other = _draw_needle(
        random,
        sheath_tip_mm=(start, y - (z - start) * np.tan(angle)),
        heading_rad=angle,
        curvature_per_mm=0.0,
        length_mm=random.uniform(35.0, 50.0),
    )
    return _draw_scene(random, needle, others=(other,))


KINDS: dict[str, Callable[[Generator], Scene]] = {
    "plain": lambda random: _draw_scene(random, _draw_needle(random)),
    "no sheath": _draw_bare,
    "sheath of 1.2 to 1.5 needle diameters": partial(_draw_sheath, 1.2, 1.5),
    "sheath of 1.5 to 2.5": partial(_draw_sheath, 1.5, 2.5),
    "sheath of 2.5 to 4": partial(_draw_sheath, 2.5, 4.0),
    "bright wall across the needle": _draw_wall_across,
    "bright wall beside it": partial(_draw_wall_beside, (215.0, 250.0)),
    "dark wall beside it": partial(_draw_wall_beside, (40.0, 90.0)),
    "gel's edge, bright table": partial(_draw_edge, "bright table"),
    "gel's edge, dark table": partial(_draw_edge, "dark table"),
    "holder in view": partial(_draw_edge, "holder"),
    "wire across, 34 to 90 degrees": partial(_draw_wire, (0.6, np.pi / 2.0)),
    "wire across, 9 to 34 degrees": partial(_draw_wire, (0.15, 0.6)),
    "two needles that cross": _draw_two_needles,
}
