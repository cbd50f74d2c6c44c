"""imported_pictures: pictures that were taken elsewhere, made into a run by `labrig import`."""

from labrig.runner.experiment import Experiment

EXPERIMENT = Experiment("import", __name__, "Imported pictures")
