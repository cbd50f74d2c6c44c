"""Certificates: what would have to be wrong for an insertion to miss, by its virtual repetitions."""

import math
from collections.abc import Generator, Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import pytest
from labrig.devices.replayed.opening import load_recorded_rig

from labrig.analysis.certificate import Certificate, Margin, load_certificate, write_certificate
from labrig.analysis.outcome import TaskOutcome
from labrig.campaign.certificate import (
    RepeatOrder,
    certify,
    compute_repetition,
    make_certificate,
    make_inputs,
    prepare_repeat,
)
from labrig.campaign.statistics import bound_share
from labrig.errors import InputError, LabrigError, RecordError
from labrig.experiments.registry import find_run_experiment, load_run_protocol
from labrig.record.check import check_run
from labrig.record.reader import Run, open_run
from labrig.report.certificate_view import make_certificate_view
from labrig.runner.assumption import VirtualRepeat
from tests.analysis.synthetic import NOW
from tests.experiments.insertion.test_procedure import conduct_insertion, insertion

RECORDS = Path(__file__).parents[1] / "records"
TINY = (
    "target.position_mm=[0,-1,12]",
    "insertion.frame_every_mm=6",
    "insertion.max_length_mm=30",
    "policy.near_mm=0",
    "policy.final_mm=0",
)


@cache
def record_tiny() -> Run:
    """Conduct an insertion that is soon over, once for all tests that only read it."""
    protocol = insertion(*TINY, "out_of_plane.start_sd_mm=0.5")
    return conduct_insertion(Path(mkdtemp(prefix="labrig-certificate-")), protocol)[1]


def repeat_only(*names: str, run: Run | None = None) -> VirtualRepeat:
    """Return how the run is repeated, with these assumptions alone."""
    repeat = prepare_repeat(record_tiny() if run is None else run)
    chosen = [assumption for assumption in repeat.assumptions if assumption.name in names]
    assert len(chosen) == len(names)
    return replace(repeat, assumptions=chosen)


def compute(orders: Iterable[RepeatOrder]) -> Generator[TaskOutcome | LabrigError, None, None]:
    """Compute repetitions in this process."""
    yield from map(compute_repetition, orders)


def search(repeat: VirtualRepeat, repetitions: int = 20) -> Certificate:
    """Return the certificate of the run."""
    told: list[tuple[int, int]] = []
    found = certify(repeat, compute, lambda done, left: told.append((done, left)), repetitions=repetitions)
    assert [done for done, _ in told] == list(range(1, found.insertions + 1))
    return make_certificate(record_tiny(), found, created=NOW, provenance={})


SPREAD = "sheath out of the plane (SD)"


@cache
def certify_spread() -> Certificate:
    """Return the certificate of the run, of a sheath that is out of the plane."""
    return search(repeat_only(SPREAD))


def find_margin(certificate: Certificate) -> Margin:
    """Return the only margin."""
    (margin,) = certificate.margins
    return margin


def test_at_the_reported_value_half_arrive_with_other_seeds() -> None:
    """The value is that by the normal distribution, and a fresh sample there arrives in half of its repetitions."""
    margin = find_margin(certify_spread())
    assert margin.misses_at is not None
    there = margin.misses_at.arrivals
    assert (there.n, 2 * there.arrived < there.n) == (20, True)
    assert there.share_ci95 == bound_share(there.arrived, there.n)
    # The needle is 2 mm from the target at most, and hardly off in the plane: half of the sheaths are within 2 mm.
    by_theory_mm = 2.0 / 0.6745
    assert margin.misses_at.value == pytest.approx(by_theory_mm, rel=0.4)
    more, fewer = margin.half_between
    assert more is not None
    assert more < margin.misses_at.value <= (fewer or math.inf)
    repeat = repeat_only(SPREAD)
    inputs, settings = make_inputs(repeat), repeat.assumptions[0].settings(margin.misses_at.value)
    orders = (RepeatOrder(repeat.simulate, inputs, settings, seed) for seed in range(9000, 9040))
    arrived = sum(map(repeat.arrives, map(compute_repetition, orders)))
    low, high = bound_share(arrived, 40) or (0.0, 1.0)
    assert max(low, there.share_ci95[0]) <= min(high, there.share_ci95[1])


def test_a_seed_gives_the_same_certificate_again() -> None:
    """All but its time and provenance follows from the run and its seed."""
    repeat = repeat_only(SPREAD)
    repeat = replace(repeat, assumptions=[replace(repeat.assumptions[0], highest=3.0)])
    protocol = repeat.protocol.model_copy(update={"seed": 3})
    first, again = search(repeat, 6), search(repeat, 6)
    assert first == again
    assert search(replace(repeat, protocol=protocol), 6).margins != first.margins


def test_a_target_that_is_elsewhere_is_missed_beyond_the_tolerance() -> None:
    """The target is moved in the world alone: the needle goes where the run believed it, 2 mm off at most."""
    certificate = search(repeat_only("target aside (y)"), 6)
    assert certificate.base.arrived == certificate.base.n == 6
    below, above = sorted(certificate.margins, key=lambda margin: margin.direction)
    for margin in (below, above):
        assert margin.margin == pytest.approx(2.0, abs=0.4)
        assert (margin.sd, margin.margin_sds, margin.at_sds) == (None, None, ())
        assert margin.main_end == "elsewhere, believed to be at the target"
    assert below.misses_at is not None
    assert below.misses_at.value < 0.0


def test_an_insertion_that_cannot_miss_by_something_says_how_far_that_was_tried() -> None:
    """Closing hinges hardly matter to a target straight ahead."""
    margins = search(repeat_only("length over which the hinges close"), 5).margins
    assert {margin.direction for margin in margins} == {-1, 1}
    for margin in margins:
        assert (margin.misses_at, margin.margin) == (None, None)
        assert margin.farthest == (pytest.approx(0.1) if margin.direction < 0 else 40.0)


def test_a_run_that_would_miss_anyhow_has_no_margins() -> None:
    """Fewer than half arrive although nothing is wrong: nothing is turned, and the page says so."""
    repeat = replace(repeat_only(SPREAD), arrives=lambda _: False)
    certificate = search(repeat, 3)
    assert (certificate.base.arrived, certificate.margins, certificate.insertions) == (0, (), 3)


def test_a_certificate_is_sealed_numbered_and_read_back(tmp_path: Path) -> None:
    """The newest counts; the record stays sound, and a certificate that was changed is refused."""
    _, run = conduct_insertion(tmp_path, insertion(*TINY))
    assert (load_certificate(run), make_certificate_view(run)) == (None, None)
    first = certify_spread()
    newest = first.model_copy(update={"seed": 9})
    files = [write_certificate(run, certificate) for certificate in (first, newest)]
    assert [file.parent.name for file in files] == ["001", "002"]
    assert load_certificate(open_run(run.path)) == newest
    checked = check_run(run.path)
    assert (checked.seal, checked.damage, checked.notices) == ("sealed", (), ())
    files[1].write_text(
        files[1].read_text(encoding="utf-8").replace('"seed": 9', '"seed": 8'), encoding="utf-8"
    )
    with pytest.raises(RecordError, match="certificate/002"):
        load_certificate(open_run(run.path))


@pytest.mark.parametrize("name", ["steerability", "design"])
def test_a_run_that_steers_to_no_target_is_refused(name: str) -> None:
    """The experiment says that there is nothing to be turned."""
    with pytest.raises(InputError, match="has no assumptions"):
        prepare_repeat(open_run(RECORDS / name))


def test_a_run_on_a_bench_is_repeated_in_the_world_that_it_assumed() -> None:
    """Its rig has no world: one is made of the protocol, the needle arrives there, and the certificate says so."""
    run = record_tiny()
    rig = load_recorded_rig(run)
    bench = rig.model_copy(update={"kind": "bench", "world": None, "state_file": "state.json"})
    experiment = find_run_experiment(run)
    repeat = experiment.list_assumptions(run, load_run_protocol(run), bench.placed_in(rig.folder))
    certificate = search(replace(repeat, assumptions=()), 3)
    assert (certificate.base.arrived, certificate.margins) == (3, ())
    assert "The run was made on a bench." in certificate.notes[0]


def test_a_run_that_never_planned_is_refused(tmp_path: Path) -> None:
    """Behind a wall there was no path, and so nothing is to be repeated."""
    wall = (
        "obstacles=[{position_mm: [0, 0, 25], radius_mm: 20}]",
        "planner.max_arcs=2",
        "target.position_mm=[0,0,60]",
    )
    _, run = conduct_insertion(tmp_path, insertion(*wall))
    with pytest.raises(InputError, match="never planned"):
        prepare_repeat(run)


def test_an_insertion_of_an_older_labrig_is_repeated() -> None:
    """A kept record is read, with its target, obstacles and roll zero."""
    repeat = prepare_repeat(open_run(RECORDS / "insertion"))
    assert len(repeat.assumptions) > 10
    assert {assumption.name for assumption in repeat.assumptions} >= {"radius of curvature", "roll zero"}
