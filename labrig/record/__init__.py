"""record: a run on disk: crash-safe writer, tolerant reader, catalogue.

`Recorder` writes a run while it happens, `open_run` reads it, `list_runs` lists a folder of runs:

.. code-block:: text

    RUN/
      manifest.json      experiment, times, operator, protocol, provenance; `exit_status` is `incomplete` until the run
                         has ended. What a list of runs shows stands in its first kilobyte
      protocol.yaml      as resolved; rig.yaml likewise, absent without a rig
      code.diff          changes of the code since its commit, if any; code.002.diff for the second session of a
                         resumed run, and so on
      calibration/       copies of the files that map pixels to mm
      frames/NNNNNN.png  pictures, lossless, numbered from 000000; .pgm or .ppm of a camera too fast for PNG
      frames.jsonl       one line a picture: number, file, SHA-256, rig time (error at most t_bound_s), and the
                         positions of the axes (`fraction` of the way from the reading before it to the one after)
      states.jsonl       one line a reading of the axes that the procedure was given
      events.jsonl       one line an event: requests, commands and answers; it defines the trials
      devices.jsonl      what the devices said of themselves, at the begin and the end of each session
      can.log            every CAN frame sent (T) and received (R), in candump's format and rig time; written with the
                         next state or event, so that a killed process loses the frames since
      truth.jsonl        what a simulated world drew; only the final comparison reads it
      SHA256SUMS         of what the run began with, from its start; of all of the above, once it has ended
      notes.json         annotations: tags, notes, a verdict; report.html and view.rrd beside it. No checksum covers
                         these: they are written again
      analysis/NNN/      results, made from the above and never overwritten, each with a SHA256SUMS of its own

Decided here:

- Files of lines and single pictures instead of one container: after SIGKILL each of them opens, and people can look at
  them without labrig. HDF5 and rerun files lost whole streams in the same trial.
- Each line of events, states, frames and truth says its place in the order of all, `seq`: together they are what the
  procedure asked and was answered, which a replay repeats. can.log stays as evidence.
- A line is handed to the kernel in one write before the call returns, and a picture is complete under its name before
  its line is written. So a killed process loses nothing acknowledged. A thread of its own forces both to disk, and only
  the lines of pictures wait for it: a power cut loses at most the last two `fsync_period_s` of rig time while the disk
  keeps up; see `Recorder`. A torn last line, which a killed process may leave, is dropped by every reader.
- The raw files are never rewritten. Only the manifest is, atomically, when the run is closed or continued.
- `open_run` verifies every recorded file but the pictures, each of which is verified when it is read; `check_run` reads
  all. Nothing that was changed is used without a word. A result without its SHA256SUMS was never finished.
- The SHA-256 of SHA256SUMS stands for the whole record: write it in a notebook.
- One process writes a run: it holds `.lock`, which the kernel frees when it dies. `reopen_run` continues only an
  undamaged run. Rig time then goes on from the next whole second, so that no clock in a record goes backwards.
"""

import importlib
from typing import Any


def __getattr__(name: str) -> Any:
    """Import the reader, and pandas with it, on first use of `open_run`: `labrig runs` needs neither."""
    if name == "open_run":
        return importlib.import_module("labrig.record.reader").open_run
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
