"""insertion: section V-C of the paper, to a target between obstacles, the tip seen and the path planned anew."""

from labrig.experiments.declaration import ExperimentDeclaration

EXPERIMENT = ExperimentDeclaration(
    name="insertion",
    title="Insertion to a target",
    protocol="labrig.experiments.insertion.protocol:InsertionProtocol",
    result="labrig.experiments.insertion.result:InsertionResult",
    procedure="labrig.experiments.insertion.procedure:run",
    analyze="labrig.experiments.insertion.analysis:analyze",
    page="labrig.experiments.insertion.page:make_page",
    summary="labrig.experiments.insertion.summary:summarise",
    view="labrig.experiments.insertion.view:make_view",
    follow="labrig.experiments.insertion.view:follow",
    values="labrig.experiments.insertion.virtual:tell_values",
    tracks="labrig.experiments.insertion.analysis:list_insertion_tracks",
    reanalysis_keys=("estimator", "planner", "policy", "out_of_plane", "markers"),
    puts_needle_in_tissue=True,
    counts="insertions",
)
