"""files: recorded pictures in place of a camera, by `driver: files`; a folder, a video file or a network stream.

What is decided here
--------------------
- Recorded pictures do not show what the needle does now. They run the path of a bench without a camera and play
  a film through a protocol. With real drives, an experiment whose pictures decide motion is refused.
- Pictures with times are played in rig time from the first read on: a read waits for the first picture that is not
  older than its command. A folder without times gives its next picture for each read.
- A picture of a stream gets the time of its arrival. It counts as newer than its command if it arrives later than the
  longest latency, which the rig file states and the record keeps as the bound of its time.
- Only regular files are read, and FFmpeg alone opens videos and streams: no option, pipeline or list of files.
"""
