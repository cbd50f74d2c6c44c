"""steerability: section V-B of the paper, insertions without turning the bevel, gel by gel."""

from labrig.runner.experiment import Experiment

EXPERIMENT = Experiment("steerability", __name__, "Steerability test")
