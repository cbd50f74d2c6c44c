"""The page of a steerability sweep."""

from collections.abc import Iterator

from labrig.analysis.result import AnalysisResult
from labrig.experiments.shared.curvature_page import make_curvature_page
from labrig.experiments.shared.curvature_result import CurvatureResult
from labrig.experiments.shared.needle_events import SpecimenTrialStart
from labrig.experiments.shared.paper import PAPER_MEAN_RADIUS_MM
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.protocol.sections import Needle
from labrig.record.reader import Run
from labrig.report.figures import Design
from labrig.report.formatting import UNKNOWN, Rows, interval, join_words, number
from labrig.report.page import Page
from labrig.text import format_count


def make_page(
    run: Run, protocol: SteerabilityProtocol, result: AnalysisResult[CurvatureResult] | None
) -> Page:
    """Return the page of a sweep: its table beside the paper's, figure 8, pictures and refusals."""
    facts = _list_facts(run, protocol)
    if result is None:
        return Page(facts)
    design = Design(protocol.needle.design_radius_mm, protocol.insertion.length_mm, side=1)
    verdict = _write_verdict(protocol, result.content)
    return make_curvature_page(run, result, result.content, facts=facts, verdict=verdict, design=design)


def _list_facts(run: Run, protocol: SteerabilityProtocol) -> Rows:
    insertion = protocol.insertion
    return (
        ("Needle", f"{protocol.needle.needle_id}, {protocol.needle.diameter_mm:g} mm"),
        ("Design radius", _format_design_radius(protocol.needle)),
        ("Gels", join_words(f"{specimen.gelatin_percent:g} %" for specimen in protocol.specimens)),
        ("Insertions", f"{protocol.insertions_per_specimen} a gel, {insertion.length_mm:g} mm deep"),
        ("Order of holes", _tell_hole_order(protocol)),
        ("Insertion speed", f"{insertion.speed_mm_s:g} mm/s"),
        ("Repeated", "; ".join(_list_repetitions(run)) or UNKNOWN),
    )


def _tell_hole_order(protocol: SteerabilityProtocol) -> str:
    """Return the order of the holes within a gel, and what it means for an effect of the place."""
    if protocol.hole_order == "sequential":
        return "one after the other within each gel: a drift over time cannot be told from an effect of the place"
    return (
        f"random within each gel, from seed {protocol.seed} and the gel's place in the list: a drift over time is not "
        "taken for an effect of the place. Repeated insertions come last in their gel"
    )


def _list_repetitions(run: Run) -> Iterator[str]:
    """Yield a sentence for each repeated insertion."""
    starts = {start.trial: start for start in run.read_events(SpecimenTrialStart)}
    for again in starts.values():
        if again.repeats is not None:
            lost = starts[again.repeats]
            why = "made again" if lost.trial in run.decisions.repeated else "interrupted and repeated"
            yield (
                f"trial {lost.trial + 1} was {why} as trial {again.trial + 1}, "
                f"{again.hole_position_mm:g} mm from the first entry point instead of {lost.hole_position_mm:g} mm"
            )


def _format_design_radius(needle: Needle) -> str:
    if needle.design is None:
        return f"{needle.design_radius_mm:g} mm"
    low_to_high = interval((needle.design.radius_low_mm, needle.design.radius_high_mm))
    return f"{needle.design_radius_mm:g} mm, {low_to_high} within tolerance"


def _write_verdict(protocol: SteerabilityProtocol, content: CurvatureResult) -> list[str]:
    """Return the page in a sentence or two."""
    trials = sum(group.trials for group in content.specimens)
    measured = sum(group.n for group in content.specimens)
    if content.mean_radius_mm is None:
        return [f"No radius could be stated: {measured} of {format_count(trials, 'insertion')} measured."]
    groups = sum(group.mean_radius_mm is not None for group in content.specimens)
    sentences = [
        (
            f"{measured} of {format_count(trials, 'insertion')} measured. "
            f"The mean radius over {format_count(groups, 'gel')} is {number(content.mean_radius_mm)} mm; "
            f"the paper reports {PAPER_MEAN_RADIUS_MM:g} mm, "
            f"and the needle was designed for {protocol.needle.design_radius_mm:g} mm."
        )
    ]
    errors = [group.error_of_mean_mm for group in content.specimens if group.error_of_mean_mm is not None]
    singles = [group.worst_error_mm for group in content.specimens if group.worst_error_mm is not None]
    if errors and singles:
        sentences.append(
            f"The rig is simulated: no gel's mean is further than {max(map(abs, errors)):.3f} mm "
            f"from what was drawn, and no insertion further than {max(map(abs, singles)):.3f} mm."
        )
    return sentences
