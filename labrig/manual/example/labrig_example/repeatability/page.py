"""The result on the page and in a terminal."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from labrig.analysis.result import AnalysisResult
from labrig.analysis.summary import Summary, TextTable
from labrig.record.reader import Run
from labrig.report.page import Page
from labrig.report.pictures import THUMBNAIL, data_uri, jpeg
from labrig.text import number
from labrig_example.repeatability.protocol import RepeatabilityProtocol
from labrig_example.repeatability.result import RepeatabilityResult

TEMPLATE = Path(__file__).with_name("page.html.jinja")


def make_page(
    run: Run, protocol: RepeatabilityProtocol, result: AnalysisResult[RepeatabilityResult] | None
) -> Page:
    """Return the page: the spread, and each visit with its picture."""
    facts = (("Visits", str(protocol.visits)), ("Travel", f"{protocol.far_mm:g} mm"))
    if result is None:
        return Page(facts)
    visits = result.content.visits
    pictures = [data_uri(jpeg(run.read_frame(visit.frame), THUMBNAIL), "image/jpeg") for visit in visits]
    return Page(
        facts,
        TEMPLATE,
        [_verdict(result.document)],
        shown={"visits": list(zip(visits, pictures, strict=True))},
    )


def summarise(document: Mapping[str, Any]) -> Summary:
    """Return what a terminal shows, and the number by which reanalyses are compared."""
    rows = tuple(
        (visit["trial"], number(visit["u_px"], 2), number(visit["v_px"], 2)) for visit in document["visits"]
    )
    return Summary(
        (_verdict(document), TextTable(("visit", "u [px]", "v [px]"), rows)),
        {"spread [px]": document["spread_px"]},
    )


def _verdict(document: Mapping[str, Any]) -> str:
    if document["spread_px"] is None:
        return "The marker was found in no picture."
    word = "came back" if document["accepted"] else "did not come back"
    return f"The marker {word}: its places spread by {document['spread_px']:.2f} px."
