"""What a terminal shows of a design."""

from collections.abc import Iterator, Mapping
from typing import Any

from labrig.analysis.summary import Summary, TextTable
from labrig.needle.design_search import STEEPEST_CUT_DEG
from labrig.text import interval, number

Document = Mapping[str, Any]


def summarise(document: Document) -> Summary:
    """Return both answers side by side, with warnings about their limits."""
    search = document["search"]
    return Summary(
        tuple(_list_lines(document)),
        {
            "inclination by equation (3), degrees": document["beta_cut_deg"],
            "inclination on our contour, degrees": search["beta_cut_deg"],
            "RMSE of our plane, degrees": search["fit"]["rmse_deg"],
        },
    )


def _list_lines(document: Document) -> Iterator[str | TextTable]:
    yield (
        f"A radius of {number(document['radius_mm'], 2)} mm at a clearance of {document['clearance_mm']:g} mm: "
        f"two hinges turn {number(document['beta_rot_deg'], 2)} degrees."
    )
    yield TextTable(("", "equation (3)", "our contour"), _list_rows(document, document["search"]))
    if document["table_1"] is not None:
        yield (
            f"Table I prints {document['table_1']['beta_cut_deg']} degrees; "
            f"equation (3) solved for it gives {number(document['beta_cut_deg'], 2)}."
        )
    if document["links"] is not None:
        yield f"The tip takes {document['links']} links."
    if document["measured"] is not None:
        yield _describe_measured_needle(document["measured"])
    yield from _list_warnings(document)


def _list_rows(document: Document, search: Document) -> tuple[tuple[str, ...], ...]:
    paper_fit, own_fit = document["equation_3"], search["fit"]
    rows = [
        [
            "inclination to cut [degrees]",
            number(document["beta_cut_deg"], 2),
            number(search["beta_cut_deg"], 2),
        ],
        ["hinges turn [degrees]", number(document["beta_rot_deg"], 2), number(search["beta_rot_deg"], 2)],
        [
            "of it hinge a, hinge b",
            "-",
            f"{number(search['beta_a_deg'], 2)}, {number(search['beta_b_deg'], 2)}",
        ],
        [
            "radius within tolerances [mm]",
            interval(document["tolerance"]["radius_mm"]),
            interval(None if search["tolerance"] is None else search["tolerance"]["radius_mm"]),
        ],
    ]
    for label, key, digits in (
        ("degrees per degree of inclination", "a", 3),
        ("degrees per mm of clearance", "b", 1),
        ("constant [degrees]", "c", 3),
        ("RMSE of the plane [degrees]", "rmse_deg", 4),
    ):
        rows.append([label, number(paper_fit[key], digits), number(own_fit[key], digits)])
    return tuple(tuple(row) for row in rows)


def _describe_measured_needle(measured: Document) -> str:
    own = measured["search_clearance_mm"]
    return (
        f"Measured {number(measured['radius_mm'], 2)} mm means {number(measured['beta_rot_deg'], 2)} degrees; cut at "
        f"{number(measured['beta_cut_deg'], 2)} degrees, a clearance of {number(measured['clearance_mm'], 4)} mm by "
        f"equation (3), {number(own, 4)} mm by our contour."
    )


def _list_warnings(document: Document) -> Iterator[str]:
    if not document["equation_3"]["same_tube"]:
        yield "Equation (3) was fitted to a tube of 1.2 and 0.7 mm; for this one only our contour was searched."
    if document["search"]["reason"] is not None:
        yield f"No answer of our own: {document['search']['reason']}."
    if document["search"]["inside_grid"] is False:
        yield f"The inclination is beyond the searched grid, which ends at {STEEPEST_CUT_DEG:g} degrees."
    yield "Our contour is not the paper's, whose figure 2 is not in its text: it shows trends, and is not for cutting."
