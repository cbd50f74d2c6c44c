"""Runs and exports behind URLs, as in a lab's object store; fsspec's own memory stands for it."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import fsspec
import numpy as np
import pytest

from labrig.errors import DiskError, InputError, OutputExistsError, RecordError
from labrig.record.reader import open_run
from labrig.record.remote import copy_record, is_url, output_folder, require_local, restore_url
from tests.record.runs import closed_run, picture

STORE = "memory://lab/runs/one"


@pytest.fixture
def store() -> Iterator[fsspec.AbstractFileSystem]:
    """An object store that is empty before and after."""
    files = fsspec.filesystem("memory")
    _empty(files)
    yield files
    _empty(files)


def _empty(files: fsspec.AbstractFileSystem) -> None:
    files.store.clear()
    files.pseudo_dirs[:] = [""]


def _put(run: Path, url: str) -> None:
    with output_folder(url, force=False) as folder:
        copy_record(run, folder)


def test_a_run_is_kept_and_opened_in_an_object_store(
    tmp_path: Path, store: fsspec.AbstractFileSystem
) -> None:
    """What was copied there opens as it is: whole, with its pictures, checked by its hashes."""
    _put(closed_run(tmp_path), STORE)
    run = open_run(STORE)
    assert run.damage == ()
    np.testing.assert_array_equal(run.pictures[2], picture(2))
    assert len(run.trials) == 2


def test_damage_in_the_store_is_named(tmp_path: Path, store: fsspec.AbstractFileSystem) -> None:
    """A bit that flipped there is found when the run is opened."""
    _put(closed_run(tmp_path), STORE)
    with store.open("/lab/runs/one/states.jsonl", "r+b") as file:
        file.write(b'{"u')
    assert [problem.where for problem in open_run(STORE).damage] == ["states.jsonl"]


def test_a_name_that_leads_out_of_the_run_is_refused(
    tmp_path: Path, store: fsspec.AbstractFileSystem
) -> None:
    """A store may hold any name; none is written outside the copy."""
    store.pipe("/lab/runs/one/../../evil", b"x")
    with pytest.raises(RecordError, match="leads out of the run"):
        open_run(STORE)


def test_what_is_not_there_is_named(store: fsspec.AbstractFileSystem) -> None:
    """An address without a run, and a kind of address that nobody knows."""
    with pytest.raises(RecordError, match="nothing is there"):
        open_run("memory://lab/none")
    with pytest.raises(InputError, match="Protocol not known"):
        open_run("nowhere://lab/none")


class BrokenStoreError(Exception):
    """What the library of a store raises, of a kind that labrig does not know."""


class BrokenStore(fsspec.AbstractFileSystem):  # type: ignore[misc] # fsspec is untyped
    """A store whose server is down."""

    protocol = "smb"

    def find(self, *_: object, **__: object) -> list[str]:
        """Find nothing."""
        raise BrokenStoreError("endpoint did not answer")

    def exists(self, *_: object, **__: object) -> bool:
        """Tell nothing."""
        raise BrokenStoreError("endpoint did not answer")


def test_a_store_that_does_not_answer_is_named(tmp_path: Path) -> None:
    """An error of the store's own library is told with the address, in reading and in writing."""
    fsspec.register_implementation("smb", BrokenStore, clobber=True)
    with pytest.raises(DiskError, match="cannot read smb://lab/one: endpoint did not answer"):
        open_run("smb://lab/one")
    with (
        pytest.raises(DiskError, match="cannot write smb://lab/one"),
        output_folder("smb://lab/one", force=False),
    ):
        pass


def test_a_kind_of_address_whose_package_is_missing_names_it() -> None:
    """What has to be installed is said, and that it goes beside labrig."""
    fsspec.register_implementation(
        "oss", "no_such_package.Store", clobber=True, errtxt="Install no_such_package"
    )
    with pytest.raises(InputError, match="Install no_such_package") as refusal:
        open_run("oss://lab/one")
    assert "pip" in refusal.value.hint


@pytest.mark.parametrize(
    "url", ["reference:///lab/refs.json", "zip::reference:///refs.json", "github://lab:one@/x"]
)
def test_a_store_that_does_what_a_file_tells_it_is_refused(url: str) -> None:
    """The schemes are listed: others of fsspec read other files, or other servers, than the address names."""
    with pytest.raises(InputError, match=r"labrig does not follow (reference|github):") as refusal:
        open_run(url)
    assert "s3, " in refusal.value.hint


def test_a_run_in_a_zip_file_is_read(tmp_path: Path) -> None:
    """A zip file is a place like any other; one that is none is named, with how a zip file is addressed."""
    closed_run(tmp_path, "one")
    shutil.make_archive(str(tmp_path / "one"), "zip", tmp_path / "one")
    assert open_run(f"zip::file://{tmp_path}/one.zip").damage == ()
    (tmp_path / "none.zip").write_text("no zip file")
    with pytest.raises(DiskError, match="not a zip file") as refusal:
        open_run(f"zip::file://{tmp_path}/none.zip")
    assert "zip::file:///" in refusal.value.hint


@pytest.mark.parametrize(
    "url", ["s3://lab/one", "file:///lab/one", "zip::file:///lab/one.zip", "simplecache::s3://x"]
)
def test_a_path_made_of_a_url_is_a_url_again(url: str) -> None:
    """A Path takes slashes away; they come back."""
    assert restore_url(Path(url)) == url


def test_nothing_there_is_replaced_unasked(tmp_path: Path, store: fsspec.AbstractFileSystem) -> None:
    """An export that exists, in the store or on disk, is refused; forced, its files are replaced and others stay."""
    for out in (STORE, str(tmp_path / "out")):
        with output_folder(out, force=False) as folder:
            (folder / "a.csv").write_text("1")
            (folder / "b.csv").write_text("1")
        with pytest.raises(OutputExistsError, match="exists already"), output_folder(out, force=False):
            pass
        with output_folder(out, force=True) as folder:
            (folder / "a.csv").write_text("2")
    assert (tmp_path / "out" / "a.csv").read_text() == "2"
    assert (tmp_path / "out" / "b.csv").read_text() == "1"
    assert (store.cat("/lab/runs/one/a.csv"), store.cat("/lab/runs/one/b.csv")) == (b"2", b"1")


def test_a_link_in_the_place_of_an_export_is_not_followed(tmp_path: Path) -> None:
    """A link to a folder or file within an existing export is replaced, and nothing is written where it leads."""
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    out.mkdir()
    elsewhere.mkdir()
    (elsewhere / "a.csv").write_text("mine")
    (out / "frames").symlink_to(elsewhere)
    (out / "a.csv").symlink_to(elsewhere / "a.csv")
    with output_folder(str(out), force=True) as folder:
        (folder / "frames").mkdir()
        (folder / "frames" / "1.png").write_text("1")
        (folder / "a.csv").write_text("2")
    assert {path.name: path.read_text() for path in elsewhere.iterdir()} == {"a.csv": "mine"}
    assert (out / "frames" / "1.png").read_text() == "1"
    assert (out / "a.csv").read_text() == "2"


def test_an_export_that_fails_leaves_nothing(tmp_path: Path, store: fsspec.AbstractFileSystem) -> None:
    """Files are put in their place when all of them are whole."""
    for out in (STORE, str(tmp_path / "out")):
        with pytest.raises(RecordError, match="a picture is damaged"):
            _fail_to_write(out)
    assert list(tmp_path.iterdir()) == []
    assert not store.exists("/lab/runs/one")


def _fail_to_write(out: str) -> None:
    with output_folder(out, force=False) as folder:
        (folder / "a.csv").write_text("1")
        raise RecordError("a picture is damaged")


@pytest.mark.parametrize("place", ["s3://lab/runs", "memory://x", "s3:/lab/runs", "simplecache::s3://lab"])
def test_a_live_run_is_refused_an_object_store(place: str) -> None:
    """A URL, also one that a path has been made of, is refused with what to do instead."""
    with pytest.raises(InputError, match="local disk") as refusal:
        require_local(Path(place))
    assert "labrig export" in refusal.value.hint


def test_a_local_folder_is_no_url(tmp_path: Path) -> None:
    """Folders with colons and plain names are local."""
    for place in (tmp_path, "data/runs", "C:/runs", "gel: 13", "a:b"):
        assert not is_url(place)
    shutil.rmtree(tmp_path)
