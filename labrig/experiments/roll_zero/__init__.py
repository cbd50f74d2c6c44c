"""roll_zero: which roll of the rotation axis bends the needle towards -y."""

from labrig.runner.experiment import Experiment

EXPERIMENT = Experiment("roll-zero", __name__, "Roll zero", reanalysis_keys=())
