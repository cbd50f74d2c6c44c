"""What is said of a lab folder whose files another version of labrig wrote."""

from labrig.cli.output import say_wrapped
from labrig.errors import InputError
from labrig.lab.folder import find_lab_folder
from labrig.lab.marker import read_marker


def remark_on_lab_version() -> None:
    """Say if an older or a newer labrig wrote the examples and schemas of the lab folder, and what to do about it."""
    lab = find_lab_folder()
    if lab is None:
        return
    try:
        marker = read_marker(lab)
    except InputError as error:
        say_wrapped(f"note: {error.message}; {error.hint}")
        return
    if marker is None:
        return
    from labrig import __version__  # the metadata of the package takes 10 ms to read

    if marker.is_newer_than(__version__):
        why, remedy = marker.explain_newer(__version__)
        say_wrapped(f"note: this lab folder was made {why}; {remedy}")
    elif marker.is_older_than(__version__):
        from labrig.lab.making import suggest_update

        say_wrapped(
            f"note: schemas and examples of this lab folder are of labrig {marker.labrig}, this is {__version__}; "
            f"bring them up to date: {suggest_update(lab)}"
        )
