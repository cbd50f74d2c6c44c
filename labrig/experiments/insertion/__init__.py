"""insertion: section V-C of the paper, to a target between obstacles, the tip seen and the path planned anew."""

from labrig.runner.experiment import Experiment

EXPERIMENT = Experiment(
    "insertion",
    __name__,
    "Insertion to a target",
    reanalysis_keys=("estimator", "planner.radius_mm", "policy.backlash_mm", "out_of_plane", "markers"),
    counts="insertions",
)
