"""analysis: from a run on disk to its result, with uncertainty.

One door, `analyze_run`, serves the run that has just ended and the reanalysis of an old one; `analyze_runs` takes
several at once. It reads the
record, never changes it, and writes a new folder `RUN/analysis/NNN/` each time, so that old results stay
beside new ones.

What is decided here:

- **Every picture of the needle is measured** (roles advance, final and imported), by the functions of
  `vision` that the live run uses too. A picture that cannot be measured is refused with its reason and
  counted; the batch goes on.
- **The radius of an insertion is that of its final picture alone**, as in the paper ("the final shapes of
  the needles were pictured"). Pictures on the way are kept for looking at, not averaged in.
- **Insertions are grouped by needle and gel**, the paper's "needle-tissue pair". The spread is the sample
  standard deviation (n - 1); the interval is Student's, of the mean, at 95 %. It covers the scatter between
  insertions, and how sure the bevel's roll is (`analysis.roll_sd_deg`): a bevel out of the plane by rho shows
  r / cos(rho), so the lower end is multiplied by the cosine of 1.96 standard deviations. It does not cover what
  else all of them share: the scale of the plane calibration, refraction in the gel, the optics.
- **The origin of a trial** is the sheath's tip and heading in the picture taken once it is in. Origin and linear
  encoder say where it should be; what is off along the insertion, across it or turned has a limit and a sentence of
  its own. A radius does not depend on it; where the needle's tip is told from it, the table says so.
- **Graph paper before and after a run** puts drift into the error bars of radii and of target errors, or refuses them.
- **The mean radius of a run is the mean of its groups' means**, which is what "an average of 27.6 mm" is in
  the paper.
- **A design** is studied by equation (3) and by our own search, through the same function as `labrig design`; what the
  design run adds is the record. Its folder also holds the grid of figure 3 and a design file.
- **An insertion's error** is that of the shaft's end in the final picture, not of the template that steered it; its
  standard deviation holds the reading of that end, lens, plane map and drift. What
  was known and told on the way is worked out again from the recorded pictures and the turns that were made.
- **The parent of a result is the newest one with the run's own settings**, so that each what-if stands beside the run
  as it was, and not beside the what-if before it.
- **Truth**, where the world was simulated, is compared at the very end and used for nothing else.

The result does not depend on the number of worker processes. An analysis that measures pictures is a generator: it asks
for a `PictureWork` and goes on with what was seen. So one run, and several of different lengths, keep every core busy
until the end.
"""
