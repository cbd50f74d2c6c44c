"""files: recorded pictures in place of a camera, by `driver: files`; a folder, a video file or a network stream.

What is decided here
--------------------
- Recorded pictures do not show what the needle does now. They serve to run a bench's path without a camera and to drive
  a film through a protocol; with real drives, an experiment whose pictures decide motion is refused.
- Pictures with times are played in the rig's time from the first look on: a look takes the first one that is not older
  than its command, and waits for it. A folder without times gives its next picture for each look.
- A picture of a stream is timed by its arrival. It counts as newer than its command once it arrives later than the
  longest time that one is on its way, which the rig file states and the record keeps as the bound of its time.
- Only regular files are read, and FFmpeg alone opens videos and streams: no option, pipeline or list of files.
"""
