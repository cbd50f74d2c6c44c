"""hinge_design: section III of the paper, what to cut for a steering radius; moves nothing."""

from labrig.experiments.declaration import ExperimentDeclaration

EXPERIMENT = ExperimentDeclaration(
    name="design",
    title="Design of the hinges",
    protocol="labrig.experiments.hinge_design.protocol:DesignProtocol",
    result="labrig.experiments.hinge_design.result:DesignResult",
    procedure=None,
    problems="labrig.experiments.hinge_design.plan:find_design_problems",
    analyze="labrig.experiments.hinge_design.study:analyze",
    page="labrig.experiments.hinge_design.page:make_page",
    summary="labrig.experiments.hinge_design.summary:summarise",
    simulate="labrig.experiments.hinge_design.virtual:simulate",
    counts="hinges",
)
