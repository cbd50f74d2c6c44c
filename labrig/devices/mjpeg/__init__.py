"""mjpeg: a camera whose pictures come over HTTP with their time of exposure, by `driver: mjpeg`.

What is decided here
--------------------
- The stream is `multipart/x-mixed-replace` with a JPEG in each part. `X-Timestamp` in the header of each part, as
  mjpg-streamer sends it, is the time of exposure in seconds since 1970. So each picture is known to be newer than its
  command, and an experiment may move by what it shows. A stream without such times is refused when it is opened;
  `driver: files` takes it as recorded pictures.
- The stamp is the sender's. The rig file states how far it may be wrong (`stamp_error_s`): the time from exposure to
  stamp, and the difference of the two clocks if the sender is another computer, whose clock must be kept synchronised.
  labrig can check only what it sees. A picture that is older on arrival than `latency_s`, that comes before its stamp,
  or that is not later than the one before is dropped. A camera that gives no other is an error that says why.
- FFmpeg, and OpenCV with it, reads such streams but keeps no header of a part; `http.client` reads both here. A part is
  bounded by the size of a picture without compression.
"""
