"""roll_zero: which roll of the rotation axis bends the needle towards -y."""

from labrig.experiments.declaration import ExperimentDeclaration

EXPERIMENT = ExperimentDeclaration(
    name="roll-zero",
    title="Roll zero",
    protocol="labrig.experiments.roll_zero.protocol:RollZeroProtocol",
    result="labrig.experiments.roll_zero.result:RollZeroResult",
    procedure="labrig.experiments.roll_zero.procedure:run",
    analyze="labrig.experiments.roll_zero.analysis:analyze",
    page="labrig.experiments.roll_zero.page:make_page",
    summary="labrig.experiments.roll_zero.result:summarise",
    puts_needle_in_tissue=True,
)
