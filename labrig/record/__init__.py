"""record: a run on disk: crash-safe writer, tolerant reader, catalogue.

`Recorder` writes a run while it happens, `open_run` reads it, `list_runs` lists a folder of runs:

.. code-block:: text

    RUN/
      manifest.json      experiment, times, operator, provenance; `exit_status` is `incomplete` until the run has ended
      protocol.yaml      as resolved; rig.yaml likewise, absent without a rig
      code.diff          changes of the code since its commit, if any; code.002.diff for the second session of a
                         resumed run, and so on
      calibration/       copies of the files that map pixels to mm
      frames/NNNNNN.png  pictures, lossless, numbered from 000000
      frames.raw         instead of these, if the camera is too fast for PNG: pictures one after another
      frames.jsonl       one line a picture: number, file, SHA-256, rig time (error at most t_bound_s), and the
                         positions of the axes (`fraction` of the way from the reading before it to the one after)
      states.jsonl       one line a reading of the axes
      events.jsonl       one line an event: requests, commands and answers; it defines the trials
      can.log            every CAN frame sent (T) and received (R), in candump's format and rig time; written with the
                         next state or event, so that a killed process loses the frames since
      can.sums.jsonl     a line for each part of can.log: its end and CRC-32
      truth.jsonl        what a simulated world drew; only the final comparison reads it
      SHA256SUMS         of the above except the manifest, once the run is closed (for `sha256sum -c`)
      chain.jsonl        one line a link: number, kind, time, SHA-256 of each file that it covers (of the first `bytes`
                         of a file that still grows), and `previous`, the SHA-256 of the whole line before it
      notes.jsonl        annotations: tags, notes with their revisions, a verdict
      torn/NNN/          what an interruption left half written, set aside when the run was closed or continued
      manifest.NNN.json, SHA256SUMS.NNN   those of a closed run that was continued, as its closing link covers them
      analysis/NNN/      results, made from the above and never overwritten

Decided here:

- Files of lines and single pictures instead of one container: after SIGKILL each of them opens, and people can look at
  them without labrig. HDF5 and rerun files lost whole streams in the same trial.
- Each line ends with a CRC-32 of its content, so a flipped bit is refused with file and line. Only a torn last line of
  a run that was never closed is forgiven, because a killed process leaves one: it is dropped and reported in
  `Run.problems`. Everything else that is missing or changed, in a closed run even a last line, is in `Run.damage`. The
  manifest carries the same checksum over its content.
- A line is handed to the kernel in one write before the call returns, and a picture is complete under its name before
  its line is written. So a killed process loses nothing acknowledged. A thread of its own forces both to disk, and only
  the lines of pictures wait for it: a power cut loses at most the last two `fsync_period_s` of rig time while the disk
  keeps up; see `Recorder`.
- Equal calls give equal bytes in frames/ and all lines: neither holds calendar time or a path.
- Lists and searches read the folders. `.catalogue.sqlite3` beside them is a cache, each run under the time, size and
  inode of its files: delete it or copy runs, and the answers stay the same.
- The raw files are never rewritten. Only the manifest is, atomically, when the run is closed or continued.
- The first link covers what the run begins with, and the manifest names its hash. A `close` link covers the closed
  manifest, SHA256SUMS and with it every raw file: its hash is the root of the run. `result`, `page` and
  `note` follow; `open` says that the run was continued. Of a run with a chain nothing is used that no link covers.
  Anybody who may write the folder can write the chain anew: only a hash kept elsewhere shows that.
- A file is complete before its link is written, so a process that is stopped between the two leaves a file without a
  link: it is named, not used, and `--repair` covers it by a link `unsealed`. Only the manifest of a closing run waits
  for its link, as `.manifest.closing`: `--repair` puts it into place.
- A run checks itself when it closes, as `check_run` does; one that is damaged as labrig wrote it is kept, marked in its
  manifest (`damaged_when_closed`), and ends as a bug. A picture is hashed when it is read, once in a process as long as
  its file is the same, and `open_run(..., read_pictures=True)` reads all: nothing is computed from a changed one.
- One process writes a run: it holds `.lock`, which the kernel frees when it dies. `check_run` reads everything and
  tells damage from what an interruption left; `repair_run` closes and `Recorder.reopen` continues only an undamaged
  run. Rig time then goes on from the next whole second, so that no clock in a record goes backwards.
"""

import importlib
from typing import Any


def __getattr__(name: str) -> Any:
    """Import the reader, and pandas with it, on first use of `open_run`: `labrig runs` needs neither."""
    if name == "open_run":
        return importlib.import_module("labrig.record.reader").open_run
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
