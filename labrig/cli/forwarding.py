"""How a page that is served on this computer alone is seen from another one."""

from getpass import getuser
from platform import node

from labrig.report.web_page import LOCALHOST


def suggest_forwarding(*ports: int) -> str:
    """Return the command that makes ports of this computer those of another one, typed there."""
    forward = " ".join(f"-L {port}:{LOCALHOST}:{port}" for port in ports)
    return f"ssh {forward} {getuser()}@{node()}"
