"""`labrig design`: what to cut for a radius; a short form of `labrig run protocols/design.yaml`."""

from typing import Annotated

from typer import Option

from labrig.cli.output import print_json, print_line
from labrig.cli.progress import progress


def design(
    radius_mm: Annotated[float, Option(help="Wanted steering radius.")] = 30.0,
    clearance_mm: Annotated[float, Option(help="Width of the laser's cut.")] = 0.025,
) -> int:
    """Answer by the paper's equation (3) and by our own search, which takes about half a minute on two cores.

    Exit with 1 when neither gives the radius. Tubes, tolerances, a measured needle and the design file are keys and
    files of a run of protocols/design.yaml.
    """
    from labrig.experiments.hinge_design.analysis import study_design
    from labrig.experiments.hinge_design.protocol import DesignProtocol
    from labrig.experiments.hinge_design.result import list_findings, list_warnings
    from labrig.needle.rotation_search import DEFAULT_SEED

    order = DesignProtocol.model_construct(
        experiment="design", radius_mm=radius_mm, clearance_mm=clearance_mm, seed=DEFAULT_SEED
    )
    with progress("searching rotations", 1.0) as reporter:
        study = study_design(order, progress=lambda done, of: reporter(done / of, f"{done} of {of} hinges"))
    print_json(study.model_dump(mode="json"))
    print_line("\n".join((*list_findings(study), *list_warnings(study))))
    return 0 if study.accepted else 1
