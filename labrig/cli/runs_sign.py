"""`labrig runs sign` and `runs stamp`: sign the chain of a run, or write the request for a time stamp of it."""

from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.options import LocalRunArgument
from labrig.cli.output import AsJson, print_json, print_line
from labrig.devices.clocks import SystemClock
from labrig.durable import write_atomically
from labrig.errors import OutputExistsError


def sign(
    run: LocalRunArgument,
    key: Annotated[
        Path,
        typer.Option(metavar="FILE", help="SSH key, private, or public if an agent holds the private one."),
    ],
    as_json: AsJson = False,
) -> None:
    """Sign the newest link of a run, and with it everything before."""
    from labrig.record.signature import sign_run

    link = sign_run(run, key, SystemClock().utc())
    if as_json:
        print_json({"run": str(run), "link": link.number, "sha256": link.sha256})
    else:
        print_line(f"{run}: signed link {link.number}, {link.kind}")


def stamp(
    run: LocalRunArgument,
    out: Annotated[Path, typer.Option(metavar="FILE", help="File to write, such as run.tsq.")],
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    as_json: AsJson = False,
) -> None:
    """Write the request for a time stamp of the newest link of a run (RFC 3161); labrig sends nothing."""
    from labrig.record.signature import make_stamp_request

    if out.exists() and not force:
        raise OutputExistsError(f"{out} exists already", "name another, or replace it with --force")
    link, request = make_stamp_request(run)
    write_atomically(out, request)
    if as_json:
        print_json({"run": str(run), "link": link.number, "sha256": link.sha256, "request": str(out)})
    else:
        print_line(f"{out}: send it to a time-stamping authority; the answer is of link {link.number}:")
        print_line(f"  {link.sha256}")
