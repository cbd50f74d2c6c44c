"""What the chain of a run vouches for: the record as it was closed, its results, its annotations.

Nothing that a link does not cover is used of a run that has a chain: no result, no note. A run of an earlier labrig has
no chain, and its manifest names no first link; everything in it is read as before.
"""

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from labrig.errors import Problem, RecordError
from labrig.input_file import MAX_LOG_BYTES, read_file
from labrig.record.chain import ChainScan, Link, newest_links, scan_chain
from labrig.record.digest import hash_file
from labrig.record.layout import (
    ANALYSIS,
    CALIBRATION,
    CHAIN,
    CLOSING,
    CONTROL,
    COPY_HINT,
    FRAMES,
    LOCK,
    MANIFEST,
    NOTES,
    REPORT,
    RESERVE,
    SHA256SUMS,
    TORN,
    VIEW,
    inside,
)
from labrig.record.manifest import read_document, recorded_sha256

_RESULT = re.compile(rf"{ANALYSIS}/(\d+)/result\.json")
_MADE_AGAIN = frozenset({REPORT, VIEW})
_OWN_HIDDEN = frozenset({LOCK, RESERVE, CONTROL, CLOSING, f".{NOTES}.lock"})
_REPAIR = "labrig runs check --repair"
_NO_PART = "nothing lists it: it is no part of the record and is not used"


@dataclass(frozen=True)
class Seal:
    """The links of a run; none of a run that was made before there were chains."""

    run: Path
    links: tuple[Link, ...]

    @cached_property
    def newest(self) -> Mapping[str, Link]:
        """The newest link that covers each file."""
        return newest_links(self.links)

    @property
    def closing(self) -> Link | None:
        """The newest link that closes the run; its hash is the run's root."""
        return next((link for link in reversed(self.links) if link.kind == "close"), None)

    def result_files(self, number: int) -> tuple[str, ...]:
        """Return the files of a result that have a link, relative to the run."""
        return tuple(name for name in self.newest if name.startswith(f"{ANALYSIS}/{number:03d}/"))

    @property
    def results(self) -> tuple[int, ...]:
        """The numbers of the results that have a link, in order."""
        return tuple(sorted(int(found[1]) for name in self.newest if (found := _RESULT.fullmatch(name))))

    def require_unchanged(self, name: str) -> None:
        """Refuse a file that is not as its link has it. Raises `RecordError`, which names the file."""
        for problem in _check_file(self.run, name, self.newest[name]):
            raise RecordError(f"{self.run / problem.where}: {problem.message}", problem.hint)


def read_seal(run: Path, manifest: Mapping[str, object] | None = None) -> Seal:
    """Return the seal of a run; its manifest is read if it is not given.

    Raises
    ------
    RecordError
        When the chain is damaged, or missing though the manifest names its first link.
    """
    scan = scan_chain(run)
    for problem in (*scan.damaged, *_check_first_link(manifest or read_document(run), scan.links)):
        raise RecordError(f"{run / problem.where}: {problem.message}", problem.hint)
    return Seal(run, scan.links)


def find_root(run: Path) -> str | None:
    """Return the hash of the newest link that closes a run; None where there is none, or the chain is damaged."""
    try:
        closing = read_seal(run).closing
    except RecordError:
        return None
    return None if closing is None else closing.sha256


def find_changes_since_sealing(
    run: Path, manifest: Mapping[str, object], scan: ChainScan
) -> Iterator[Problem]:
    """Yield damage of the chain, and of the manifest and SHA256SUMS of a closed run, on which all else hangs."""
    yield from scan.damaged
    if scan.damaged and not scan.links:
        return
    yield from _check_first_link(manifest, scan.links)
    seal = Seal(run, scan.links)
    if seal.closing is not None:
        yield from _check_closing(seal, seal.closing, manifest)
    elif scan.links and manifest.get("exit_status") != "incomplete" and _first_link(manifest) is not None:
        message = "no link closes the run, though the manifest says that it ended: links were removed"
        yield Problem(CHAIN, message, COPY_HINT)


def find_unused(run: Path, scan: ChainScan) -> Iterator[Problem]:
    """Yield the results and annotations that have no link, and a torn end of the chain: nothing of them is used."""
    yield from scan.torn
    if scan.links:
        yield from _find_unsealed(Seal(run, scan.links))


def _first_link(manifest: Mapping[str, object]) -> object:
    hashes = manifest.get("hashes")
    return hashes.get("first_link_sha256") if isinstance(hashes, Mapping) else None


def is_made_before(manifest: Mapping[str, object]) -> bool:
    """Return whether a run began before there were chains."""
    return _first_link(manifest) is None


def _check_first_link(manifest: Mapping[str, object], links: tuple[Link, ...]) -> Iterator[Problem]:
    first = _first_link(manifest)
    if first is None:
        return
    if not links:
        yield Problem(CHAIN, "it is missing, though the manifest names its first link", COPY_HINT)
    elif links[0].sha256 != first:
        yield Problem(f"{CHAIN}:1", "it is not the first link that the manifest names", COPY_HINT)


def _check_closing(seal: Seal, closing: Link, manifest: Mapping[str, object]) -> Iterator[Problem]:
    """Check manifest and SHA256SUMS with the newest link that closes the run, unless the run was opened again since."""
    if manifest.get("exit_status") != "incomplete":
        for name in (MANIFEST, SHA256SUMS):
            yield from _check_file(seal.run, name, closing)
    elif not is_closing(seal) and all(link.kind != "open" for link in seal.links[closing.number :]):
        yield Problem(MANIFEST, f"it says that the run goes on, though {_name(closing)} closes it", COPY_HINT)


def is_closing(seal: Seal) -> bool:
    """Return whether labrig was stopped while it closed the run: after the link, before the manifest."""
    path = seal.run / CLOSING
    return (
        seal.closing is not None
        and path.is_file()
        and not path.is_symlink()
        and hash_file(path) == seal.closing.files.get(MANIFEST)
    )


@dataclass(frozen=True)
class SealCheck:
    """What a check of all links finds.

    Attributes
    ----------
    damage : tuple of Problem
        Files that are missing or were changed, and files that stand among labrig's own and have no link.
    notices : tuple of Problem
        What is no part of the record and is not used, and what an interruption left without a link.
    state : str
        `sealed`; `open` for a run that has not been closed; `unsealed` where an interruption left something without a
        link; `unsealed (made before)` for a record without a chain.
    links : tuple of Link
        The links up to the first that is damaged.
    """

    damage: tuple[Problem, ...]
    notices: tuple[Problem, ...]
    state: str
    links: tuple[Link, ...]


def check_seal(run: Path, manifest: Mapping[str, object], listed: frozenset[str]) -> SealCheck:
    """Check every link of a run.

    Parameters
    ----------
    listed : frozenset of str
        The files of the run that SHA256SUMS lists.
    """
    scan = scan_chain(run)
    seal = Seal(run, scan.links)
    damage = [*find_changes_since_sealing(run, manifest, scan), *_check_beginnings(run, scan.links)]
    notices = list(scan.torn)
    for name, link in seal.newest.items():
        if name not in {MANIFEST, SHA256SUMS} and name not in link.lengths:
            found = _check_file(run, name, link)
            (notices if name in _MADE_AGAIN else damage).extend(found)
    foreign, others = _find_unlisted(run, manifest, listed | seal.newest.keys())
    if not scan.links:
        # In a record without a chain only the listing of calibration/ says what is part of it.
        return SealCheck(tuple(damage), tuple(foreign), _name_state(manifest, seal, unsealed=False), ())
    left = (*_find_unsealed(seal), *_list_repaired(seal))
    state = _name_state(manifest, seal, unsealed=bool(left))
    return SealCheck((*damage, *foreign), (*notices, *left, *others), state, scan.links)


def _name_state(manifest: Mapping[str, object], seal: Seal, unsealed: bool) -> str:
    if manifest.get("exit_status") == "incomplete":
        return "unsealed" if is_closing(seal) else "open"
    if seal.closing is None:
        return "unsealed (made before)" if is_made_before(manifest) else "unsealed"
    return "unsealed" if unsealed else "sealed"


def _name(link: Link) -> str:
    return f"link {link.number} of {CHAIN}"


def _check_file(run: Path, name: str, link: Link) -> Iterator[Problem]:
    """Compare a file with a link that covers it."""
    hint = COPY_HINT
    if name.startswith(f"{ANALYSIS}/"):
        hint = "take the file from a copy of the run, or make a new result with labrig reanalyze"
    elif name in _MADE_AGAIN:
        hint = f"make it again: labrig {'report' if name == REPORT else 'view'}"
    try:
        path = inside(run, name)
        if not path.is_file():
            yield Problem(name, f"it is missing, though {_name(link)} covers it", hint)
        elif hash_file(path, link.lengths.get(name)) != link.files.get(name):
            yield Problem(name, f"it was changed: its SHA-256 does not fit {_name(link)}", hint)
    except RecordError as error:
        yield Problem(name, error.message, error.hint)


def _check_beginnings(run: Path, links: tuple[Link, ...]) -> Iterator[Problem]:
    """Compare the files that grow with every link that covers their beginning; the first that does not fit is named."""
    changed: set[str] = set()
    for link in links:
        for name in link.lengths.keys() & link.files.keys() - changed:
            for problem in _check_file(run, name, link):
                changed.add(name)
                yield problem


def _find_unsealed(seal: Seal) -> Iterator[Problem]:
    """Yield what a process that was stopped between a file and its link left: it is not used."""
    if (lines := count_unsealed_notes(seal)) > 0:
        message = f"its last {lines} lines have no link in {CHAIN} and are not used"
        yield Problem(NOTES, message, f"labrig was stopped, or somebody added them; {_REPAIR} takes them in")
    for folder in list_unsealed_results(seal):
        message = f"this result has no link in {CHAIN} and is not used"
        hint = f"labrig was stopped, or somebody put it there; {_REPAIR} takes it in, labrig reanalyze makes another"
        yield Problem(folder, message, hint)


def _list_repaired(seal: Seal) -> Iterator[Problem]:
    for link in seal.links:
        if link.kind == "unsealed":
            for where in sorted({name.rpartition("/")[0] or name for name in link.files}):
                message = f"unsealed: {_name(link)} has covered it only since it was found without a link"
                yield Problem(where, message, "nothing shows what wrote it")


def list_unsealed_results(seal: Seal) -> list[str]:
    """Return the folders of results that have no link, relative to the run."""
    parent = inside(seal.run, ANALYSIS)
    known = {name.rpartition("/")[0] for name in seal.newest}
    folders = sorted(parent.iterdir()) if parent.is_dir() else ()
    names = (f"{ANALYSIS}/{folder.name}" for folder in folders if folder.is_dir() and not folder.is_symlink())
    return [name for name in names if name not in known]


def measure_sealed_notes(seal: Seal) -> int:
    """Return how many bytes of notes.jsonl have a link."""
    link = seal.newest.get(NOTES)
    return 0 if link is None else link.lengths.get(NOTES, 0)


def count_unsealed_notes(seal: Seal) -> int:
    """Return how many whole lines of notes.jsonl have no link. Raises `RecordError` when it cannot be read."""
    path = inside(seal.run, NOTES)
    if not path.is_file():
        return 0
    try:
        content = read_file(path, MAX_LOG_BYTES)
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}", COPY_HINT) from error
    return content[measure_sealed_notes(seal) :].count(b"\n")


def _find_unlisted(
    run: Path, manifest: Mapping[str, object], listed: frozenset[str] | set[str]
) -> tuple[list[Problem], list[Problem]]:
    """Return the files that are no part of the record: those that stand among labrig's own, and others."""
    known = {*listed, *recorded_sha256(dict(manifest)), MANIFEST, CHAIN, NOTES, SHA256SUMS}
    is_closed = manifest.get("exit_status") != "incomplete"
    own_folders = {name.rpartition("/")[0] for name in listed if name.startswith(f"{ANALYSIS}/")}
    foreign, others = [], []
    for name in _walk(run):
        folder, _, file = name.rpartition("/")
        top = name.partition("/")[0]
        if name in known or top == FRAMES or (not folder and _is_own_hidden(file)):
            continue
        among_own = top == CALIBRATION or folder in own_folders or (top == TORN and is_closed)
        if among_own and not file.startswith("."):
            foreign.append(Problem(name, _NO_PART, "move it out of the run"))
        elif among_own or (is_closed and top not in {ANALYSIS, TORN}):
            others.append(Problem(name, _NO_PART, "it may stay; no command reads it"))
    return foreign, others


def _is_own_hidden(file: str) -> bool:
    return file in _OWN_HIDDEN or (file.startswith(".") and file.endswith(".tmp"))


def _walk(run: Path) -> Iterator[str]:
    """Yield every file of a run that is no link, relative to it."""
    for parent, folders, files in os.walk(run):
        folders.sort()
        for file in sorted(files):
            path = Path(parent, file)
            if not path.is_symlink():
                yield path.relative_to(run).as_posix()
