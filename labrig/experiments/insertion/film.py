"""The film of an insertion: plan, estimate, target and obstacles in every picture that it was steered by."""

from collections.abc import Iterator, Sequence

from labrig.experiments.insertion.events import TipObserved
from labrig.experiments.insertion.result import InsertionResult, InsertionTrial
from labrig.experiments.insertion.scene import Scene, read_scenes
from labrig.record.events import Event
from labrig.record.reader import Run
from labrig.report.film_pictures import Film, FilmPicture
from labrig.vision.plane import PlaneMap


def make_films(run: Run, content: InsertionResult, plane: PlaneMap) -> tuple[Film, ...]:
    """Return a film of each insertion that was steered by pictures."""
    events = read_scenes(run)
    return tuple(
        Film(f"insertion-{trial.trial + 1}", tuple(_list_pictures(trial, events[trial.trial], plane)))
        for trial in content.insertions
        if trial.steps
    )


def _list_pictures(trial: InsertionTrial, events: Sequence[Event], plane: PlaneMap) -> Iterator[FilmPicture]:
    scene = Scene(plane)
    for event in events:
        scene.take(event)
        if isinstance(event, TipObserved):
            strokes = *scene.draw_places(), *scene.draw_ways(), *scene.draw_tip()
            at = f"{event.depth_mm:.1f} mm inserted, {event.t_s - trial.start_t_s:.0f} s"
            caption = f"{at}, {scene.left_mm:.1f} mm to the target"
            yield FilmPicture(event.frame, strokes, caption)
    if trial.final_frame is not None:
        end = *scene.draw_places(), *scene.draw_line("taken", trial.shaft_mm)
        error = (
            "not measured"
            if trial.target_error_mm is None
            else f"{trial.target_error_mm:.2f} mm from the target in the plane"
        )
        yield FilmPicture(trial.final_frame, end, f"{trial.outcome}: {error}")
