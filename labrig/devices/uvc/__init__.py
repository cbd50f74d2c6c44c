"""uvc: a USB video class camera on Linux, by `driver: uvc`; pictures through OpenCV, controls through Video4Linux2."""
