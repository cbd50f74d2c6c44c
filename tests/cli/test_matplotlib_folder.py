"""The folder that matplotlib gets where the account has none."""

from pathlib import Path

from labrig.cli.matplotlib_folder import provide_matplotlib_folder


def test_a_folder_is_given_only_where_there_is_none(tmp_path: Path) -> None:
    """A home that can be written, and a folder that the user chose, are left alone."""
    chosen = {"MPLCONFIGDIR": "/chosen", "HOME": "/dev/null/none"}
    written = {"HOME": str(tmp_path)}
    for environ in (chosen, written):
        before = dict(environ)
        provide_matplotlib_folder(environ)
        assert environ == before
    assert not list(tmp_path.iterdir())
    homeless = {"HOME": "/dev/null/none"}
    provide_matplotlib_folder(homeless)
    assert Path(homeless["MPLCONFIGDIR"]).is_dir()
