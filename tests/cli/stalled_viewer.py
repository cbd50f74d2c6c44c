"""A viewer that accepts connections and never reads: `python -m tests.cli.stalled_viewer ... --port PORT ...`."""

import signal
import socket
import sys

with socket.create_server(("127.0.0.1", int(sys.argv[sys.argv.index("--port") + 1]))) as server:
    held = []
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    while True:
        held.append(server.accept())
