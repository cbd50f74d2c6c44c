"""imported_pictures: pictures that were taken elsewhere, made into a run by `labrig import`."""

from labrig.experiments.declaration import ExperimentDeclaration

EXPERIMENT = ExperimentDeclaration(
    name="import",
    title="Imported pictures",
    protocol="labrig.experiments.imported_pictures.protocol:ImportProtocol",
    result="labrig.experiments.shared.curvature_result:CurvatureResult",
    procedure=None,
    problems="labrig.experiments.imported_pictures.protocol:find_problems",
    analyze="labrig.experiments.imported_pictures.analysis:analyze",
    page="labrig.experiments.imported_pictures.page:make_page",
    summary="labrig.experiments.shared.curvature_result:summarise",
    reanalysis_keys=("analysis",),
)
