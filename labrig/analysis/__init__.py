"""analysis: from a run on disk to its result, with uncertainty.

`analyze_run` serves both the run that has just ended and the reanalysis of an old one; `analyze_runs` takes several at
once. It reads the record, never changes it, and writes a new folder `RUN/analysis/NNN/` each time, so that old results
remain.

What is decided here:

- **Every picture of the needle is measured** (roles advance, final and imported), by the functions of `vision` that the
  live run uses too. A picture that cannot be measured is refused with its reason and counted; the batch continues.
- **The radius of an insertion comes from its final picture alone**, as in the paper ("the final shapes of the needles
  were pictured"). Earlier pictures are kept for viewing, not averaged in.
- **Insertions are grouped by needle and gel**, the paper's "needle-tissue pair". The spread is the sample standard
  deviation (n - 1); the interval is Student's, of the mean, at 95 %. It covers the scatter between insertions and
  what they share, as far as it is known: lens, plane, surface, and the bevel's roll (`analysis.roll_sd_deg`): a bevel
  out of the plane by rho shows r / cos(rho), nearer to the camera or farther from it. It does not cover a camera that
  was moved after its calibration.
- **The origin of a trial** is the sheath's tip and heading in the picture taken once it is in. Command and linear
  encoder give the expected pose; deviations along the insertion, across it and in heading have a limit and a sentence
  each. A radius does not depend on the origin; a tip relative to it is named so in the table.
- **The error bars of a single radius or tip** have a budget by source (`labrig.vision.error_budget`). A source that is
  not known is None, and not in them.
- **Graph paper before and after a run** adds drift to the error bars of radii and target errors, or refuses them.
- **The mean radius of a run is the mean of its groups' means**, like "an average of 27.6 mm" in the paper.
- **A design** is studied by equation (3) and by our own search, with the same function as `labrig design`; the design
  run adds the record. Its folder also holds the grid of figure 3 and a design file.
- **An insertion's error** is that of the shaft's end in the final picture, not of the template that steered it; its
  standard deviation covers the reading of that end, lens, plane map, drift, light and roll zero. Estimates on the
  way are computed again from the recorded pictures and the turns that were made.
- **The parent of a result is the newest one with the run's own settings**, so that each what-if is compared with the
  run as it was, and not with the what-if before it.
- **Truth** of a simulated world is compared at the very end and used for nothing else.

The result does not depend on the number of worker processes. Of one run, they measure its pictures; of several, each
takes whole runs.

`engine` does tasks of any kind in other processes: pictures, hinges, or the insertions of a campaign. A lost worker
costs only time, and a failed task is a value among the others. `cluster`, which alone imports dask, has workers on
other computers; their installation is compared with ours, since results must have the same bits wherever they are
computed.

Of comparisons (`labrig compare`, `load_runs`):

- **They read what results list**, `analysis/NNN/tables.json` and its CSV files, and the trials of the record, and know
  no experiment. A measurement is a row of a table that names trials; of a trial with several rows, as the pictures on
  the way of the needle, the one of its final picture counts.
- **The unit of analysis is the specimen.** Insertions into the same block share its gel: they say how much a radius
  scatters within it, not between gels of a kind. Where every group has two blocks or more, each block counts once, by
  its mean. Where a group has one, insertions are counted, and every output says that n, intervals and p then speak of
  these blocks alone (pseudo-replication, Hurlbert 1984).
- **Errors that measurements share do not average out.** An error of lens, plane map or surface is the same in all
  pictures with one calibration; roll of the bevel and light are the same for a needle, or a lamp, in one run; the
  scatter of the edges is each picture's own, and is in the scatter of the measurements already. So a mean has the
  shared errors on top of its interval, in full; in a difference they cancel as far as both groups have the same
  calibration, needle mounting and run, in the same shares. No record says whether the mounting of the needle and the
  light stayed from run to run: each interval is the wider one of both cases.
- **Variances are not taken to be equal**: Welch's ANOVA, and pairs by Games and Howell, at 95 % for all pairs together.
"""

import importlib
from typing import Any


def __getattr__(name: str) -> Any:
    """Import pandas, and what finds runs, on first use of `load_runs`."""
    if name == "load_runs":
        return importlib.import_module("labrig.analysis.measurements").load_runs
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
