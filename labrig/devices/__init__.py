"""devices: axis, camera, clock and operator, and the rig that holds them.

What is decided here
--------------------
- What a session asks of a rig is one interface, `rig_calls.RigCalls`. An opened rig implements it, real or simulated,
  and so does `replayed.rig.ReplayedRig`, which answers what the rig of a record answered.
- The rig file says whether a rig is real or simulated, and only `hardware.make_hardware` asks. The seam is at the
  wire: a simulated drive is a CANopen node on a bus inside the process, driven by the driver of real drives.
- A section of the rig file opens what it describes: `AxisDescription` a drive, `CameraDescription` a `PictureSource`.
  Entry points of the groups `labrig.drives` and `labrig.cameras` name the classes. There is one driver, of CiA 402
  drives (`drives/cia402`); a product is an EDS file and a `Model` (`drives/epos2`, `drives/generic`).
- Positions are mm or rad above the driver and counts of the motor below; speeds are rounded to the drive's integers,
  and the achieved one is told. Limits are checked here before anything is sent, and once more by the drive.
- A move is done when the drive says so and the position that it reads stands within the window.
- An axis without a reference does not move, and no axis is referenced while a needle is in tissue or may be;
  the state file remembers that across crashes. Nothing but `Rig.enable` switches power on: a run has its record by
  then. A fault is reset only where a rig is opened for commissioning or recovery and a person has confirmed it.
- Homing is ordered: a search needs a bare instrument, the linear module first; with a needle mounted zeros are set
  where the axes stand. Backlash stands in the rig file; moves end from one side.
- States of all axes are of one instant, that of a SYNC. The set-up of a drive may be pinned in the rig file.
- After any failure every axis is stopped, and standstill is read back; a halt, or a quick stop where somebody else
  moves an axis, goes to all of them before any answer is awaited. A table in the tests has the outcome of each fault.
  A closed rig has its power stages off.
- Every position that is read is judged against the move that was started, and axes that nobody reads are read while
  the rig waits or asks; targets are read back in turn. This stands above the driver, and so does the watch on the bus
  for another master.
- What is watched, how often, and what comes of it stands in `supervisor`. Motor current and inputs come with every
  state: a stall is judged from current and following error (`stall`), an input by its limits (`input_channel`).
- The lower one of the limits of rig file, protocol and command bounds a current (`opening`); the drive has its own
  again when the rig is closed, or opened after a labrig that was killed.
- One labrig uses a rig at a time, by a lock on its state and one on its bus, which holds among all accounts;
  `labrig devices stop` sends it SIGTERM, and stops every drive over the bus afterwards in any case.
- Each setting of the camera is read back, and one that was not accepted closes the rig. Kinds of camera are
  `uvc/`, `files` and `simulated`.
- A picture is never older than its command. If the camera gives the time of exposure, positions of the axes are
  interpolated between the readings before and after it; the bound of that time is recorded with the picture.
- One thread supervises: it talks to the drives, looks for signals, and alone sends heartbeats (`heartbeat`), also
  between two answers of drives. Whatever may block is done by a worker while it goes on supervising (`Rig.do_aside`,
  `worker`): one reads the camera, one does the rest, which is disk and long computations. The recorder has a third for
  its fsyncs. A supervisor that hangs sends no beat, and the drives stop. Simulated time stands still while something
  blocks, so that such a rig has no workers; a rehearsal, in real time, has one for the disk.
- A camera that does not answer is given up and named; rig time goes on while a computer is suspended, so that the
  gap in its heartbeat is named when it wakes. A bit rate at which the drives cannot be looked after does not open.
- This room alone reads the time, sleeps, and knows CAN, cameras and threads (python-can has one on a real bus).
"""
