"""repeatability: an axis moves away and back, and pictures show whether a marker on it comes back too."""

from labrig.experiments.declaration import ExperimentDeclaration

EXPERIMENT = ExperimentDeclaration(
    name="repeatability",
    title="Repeatability",
    protocol="labrig_example.repeatability.protocol:RepeatabilityProtocol",
    result="labrig_example.repeatability.result:RepeatabilityResult",
    procedure="labrig_example.repeatability.procedure:run",
    analyze="labrig_example.repeatability.analysis:analyze",
    page="labrig_example.repeatability.page:make_page",
    summary="labrig_example.repeatability.page:summarise",
    reanalysis_keys=("analysis",),
)
