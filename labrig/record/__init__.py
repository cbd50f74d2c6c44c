"""record: a run on disk: crash-safe writer, tolerant reader, catalogue.

`Recorder` writes a run while it happens, `open_run` reads one, `list_runs` lists a folder of them:

.. code-block:: text

    RUN/
      manifest.json      what, when, by whom, provenance; `exit_status` is `incomplete` until it has ended
      protocol.yaml      as resolved; rig.yaml likewise, absent where no rig took part
      code.diff          what the code differed from its commit, where it did; code.002.diff of a resumed run's
                         second session, and so on
      calibration/       copies of the files that map pixels to mm
      frames/NNNNNN.png  pictures, lossless, numbered from 000000
      frames.raw         in their place, where the camera is too fast for PNG: pictures one after another
      frames.jsonl       one line a picture: number, file, SHA-256, rig time (which may be wrong by t_bound_s), and
                         where the axes stood (by fraction on the way from the reading before it to the one after)
      states.jsonl       one line a reading of the axes
      events.jsonl       one line an event: what was asked, sent and answered; it makes the trials
      can.log            every CAN frame sent (T) and received (R), as candump writes them, in rig time; handed
                         over with the next state or event, so that a killed process loses the frames since
      can.sums.jsonl     a line for each part of can.log: its end and CRC-32
      truth.jsonl        what a simulated world drew; only the final comparison reads it
      SHA256SUMS         of the above except the manifest, once the run is closed (for `sha256sum -c`)
      notes.jsonl        what people said of the run afterwards: tags, notes with their revisions, a verdict
      torn/NNN/          what an interruption left half written, set aside when the run was closed or continued
      analysis/NNN/      results, made from the above and never overwritten

Decided here:

- Files of lines and single pictures instead of one container: after SIGKILL each of them opens, and people
  can look at them without labrig. HDF5 and rerun files lost whole streams in the same trial.
- Each line ends with a CRC-32 of its content, so a flipped bit is refused with file and line. The one thing
  that is forgiven is a torn last line of a run that was never closed, which is how a killed process ends: it
  is dropped and reported in `Run.problems`. Whatever else is missing or changed, of a closed run also a last
  line, is in `Run.damage`. The manifest carries the same checksum over its content.
- A line is handed to the kernel in one write before the call returns, a picture is complete under its name
  before its line is written. So a killed process loses nothing acknowledged. Both are forced to disk by a thread of its
  own, so that no axis waits for a busy disk: a power cut loses at most the last two `fsync_period_s` of rig time while
  the disk keeps up; see `Recorder`.
- Equal calls give equal bytes in frames/ and all lines: neither holds calendar time or a path.
- What is listed and searched comes from the folders. `.catalogue.sqlite3` beside them is a cache of it, each run under
  the time, size and inode of its files: throw it away, copy runs about, and the answers stay the same.
- The raw files are never rewritten. Only the manifest is, atomically, when the run is closed or continued.
- One process writes a run: it holds `.lock`, which the kernel frees when it dies. `check_run` reads everything and
  tells damage from what an interruption left; only an undamaged run is closed by `repair_run` or continued by
  `Recorder.reopen`. Rig time then goes on from the next whole second, so that no clock in a record goes backwards.
"""

import importlib
from typing import Any


def __getattr__(name: str) -> Any:
    """Import the reader, and pandas with it, once `open_run` is asked for: `labrig runs` starts without."""
    if name == "open_run":
        return importlib.import_module("labrig.record.reader").open_run
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
