"""hinge_design: section III of the paper, what to cut for a steering radius; moves nothing."""

from labrig.runner.experiment import Experiment

EXPERIMENT = Experiment("design", __name__, "Design of the hinges", reanalysis_keys=(), counts="hinges")
