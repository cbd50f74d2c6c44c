"""Lines that a person types while a program is busy with something else."""

from typing import TextIO

from labrig.posix import is_in_background, read_typed, wait_for_input


class TypedLines:
    """Takes the lines that have been typed, without waiting.

    Parameters
    ----------
    stream : TextIO
        A terminal or a pipe. Nothing is taken from a terminal while another program has it.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream: TextIO | None = stream
        self._unfinished = b""

    def take(self) -> list[str]:
        """Return the lines that have been finished since the last call, without blank ones."""
        stream = self._stream
        if stream is None or not wait_for_input(stream, 0.0) or is_in_background(stream):
            return []
        typed = _read(stream)
        if not typed:
            self._stream = None
        *lines, self._unfinished = (self._unfinished + typed).replace(b"\r", b"\n").split(b"\n")
        return [line.decode("utf-8", "replace") for line in lines if line.strip()]


def _read(stream: TextIO) -> bytes:
    """Return what can be read; nothing at the end, or where the terminal has gone."""
    try:
        return read_typed(stream)
    except OSError:
        return b""
