"""campaign: many virtual insertions, or whole simulated runs, and one table.

A campaign file names a protocol, what is varied, and how often it is repeated. A task is one run of the protocol's
experiment, whatever that is; its row holds how it ended and its quantities.

What is decided here:

- **A task is known by its number**: arm, point and seed follow from it and the file. So rows are the same bits whoever
  computes them, in whatever order, and a campaign that was killed goes on behind its last row.
- **All arms have the same seeds** (common random numbers). A difference between two arms is a mean over pairs, and is
  known more exactly than the two means.
- **Repetition changes slowest.** Whatever number of tasks is done, all arms have been repeated equally often.
- **A rule that stops a campaign is in its file**, and looks only after whole repetitions, at numbers fixed beforehand.
  It is kept with the rows, and another one does not go on with them.
- **A page claims what its intervals hold.** It says which differences have an interval without 0, and no best arm.
- **A task that fails is a row with its error.** It counts for no mean and no share, and the page says how many failed.
- **Depth `world`** asks the experiment's `simulate`: no pictures. **Depth `rig`** makes and measures a whole run on a
  simulated rig. Both have the quantities of the experiment's result, so that one campaign checks the other.
"""
