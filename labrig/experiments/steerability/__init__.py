"""steerability: section V-B of the paper, insertions without turning the bevel, gel by gel."""

from labrig.experiments.declaration import ExperimentDeclaration

EXPERIMENT = ExperimentDeclaration(
    name="steerability",
    title="Steerability test",
    protocol="labrig.experiments.steerability.protocol:SteerabilityProtocol",
    result="labrig.experiments.shared.curvature_result:CurvatureResult",
    procedure="labrig.experiments.steerability.procedure:run",
    analyze="labrig.experiments.steerability.analysis:analyze",
    page="labrig.experiments.steerability.page:make_page",
    summary="labrig.experiments.shared.curvature_result:summarise",
    view="labrig.experiments.steerability.view:make_view",
    follow="labrig.experiments.steerability.view:follow",
    tracks="labrig.experiments.steerability.analysis:list_sweep_tracks",
    reanalysis_keys=("analysis",),
    puts_needle_in_tissue=True,
)
