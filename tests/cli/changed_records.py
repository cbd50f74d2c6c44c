"""Closed runs of every experiment, changed in any file by chance: does a check name it, does a command use it?"""

import contextlib
import io
import json
import random
import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from labrig.cli.main import run_command
from labrig.record.check import check_run
from labrig.record.json_lines import decode_line, encode_line
from tests.cli.cut_runs import cut_short
from tests.cli.example_runs import EXAMPLES, make_example
from tests.record.forgery import edit_manifest, redo_chain, redo_hashes

COMMANDS: Mapping[str, tuple[str, ...]] = {
    "report": ("report", "RUN", "--json"),
    "export": ("export", "RUN", "--csv", "--out", "OUT", "--json"),
    "replay": ("replay", "RUN", "--json"),
}
_ADDED = ("mask.json", "note.txt", "999999.png", "result.json", "plane.json", "states.jsonl.bak", ".hidden")
_WRITTEN = re.compile(r"Written [^<]*")


def make_runs(folder: Path, names: Sequence[str] = EXAMPLES) -> list[Path]:
    """Return a closed run of each of these examples, and a sweep that was resumed; all were measured and annotated."""
    runs = [make_example(name, folder / name)[0] for name in names]
    if "steerability" in names:
        killed = cut_short(runs[names.index("steerability")], folder / "resumed" / "run", 5.0)
        _call("resume", killed)
        runs.append(killed)
    for run in runs:
        for words in (("tag", "-t", "pilot"), ("note", "cloudy"), ("note", "clear"), ("verdict", "doubtful")):
            _call("runs", words[0], run, *words[1:], "--by", "Ada")
        _call("reanalyze", run)
        _call("report", run)
    return runs


def _call(*words: object) -> tuple[int, str, str]:
    """Run a command line in this process and return exit code, standard output and standard error."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        exit_code = run_command([str(word) for word in words])
    return exit_code, out.getvalue(), err.getvalue()


def _flip(path: Path, source: random.Random) -> None:
    content = bytearray(path.read_bytes())
    content[source.randrange(len(content))] ^= 1 << source.randrange(8)
    path.write_bytes(content)


def _cut(path: Path, source: random.Random) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: source.randrange(len(content))])


def _edit(path: Path, source: random.Random) -> None:
    """Change a value, with its CRC where it has one; what holds no values gets other bytes at its end."""
    if path.name == "manifest.json":
        edit_manifest(path.parent, operator=f"not {source.random()}")
    elif path.suffix == ".jsonl" and path.name != "chain.jsonl":
        lines = path.read_bytes().splitlines()
        number = source.randrange(len(lines))
        fields = decode_line(lines[number])
        name = source.choice(
            [name for name in fields if name not in {"crc32", "frame", "file", "kind"}] or ["by"]
        )
        lines[number] = encode_line(
            {key: value for key, value in fields.items() if key != "crc32"} | {name: source.random()}
        ).rstrip(b"\n")
        path.write_bytes(b"\n".join(lines) + b"\n")
    else:
        content = path.read_bytes()
        digits = [found.start() for found in re.finditer(rb"[1-8]", content)] or [len(content) - 1]
        place = source.choice(digits)
        path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])


def _delete(path: Path, source: random.Random) -> None:
    path.unlink()


def _add(path: Path, source: random.Random) -> None:
    """Put a file beside this one; now and then a whole result."""
    if path.parent.parent.name == "analysis" and source.random() < 0.5:
        shutil.copytree(path.parent, path.parent.with_name(f"{source.randrange(100, 999)}"))
    else:
        (path.parent / source.choice(_ADDED)).write_bytes(b"added")


def _swap(path: Path, source: random.Random) -> None:
    """Exchange the content with that of another file, of its kind where there is one."""
    others = [other for other in path.parent.iterdir() if other.is_file() and other != path]
    alike = [other for other in others if other.suffix == path.suffix] or others
    if not alike:
        return _cut(path, source)
    other = source.choice(alike)
    content = path.read_bytes()
    path.write_bytes(other.read_bytes())
    other.write_bytes(content)
    return None


CHANGES: Mapping[str, Callable[[Path, random.Random], None]] = {
    "flip": _flip, "cut": _cut, "delete": _delete, "add": _add, "swap": _swap, "edit": _edit,
    "swap, hashes redone": _swap, "edit, hashes redone": _edit, "edit, hashes and chain redone": _edit,
}  # fmt: skip


@dataclass(frozen=True)
class ReadOutcome:
    """A change and what became of it: the command that was tried, and what it did."""

    run: str
    kind: str
    files: tuple[str, ...]
    named: bool
    command: str
    used_silently: bool
    told: str


class ChangedRecords:
    """Draws changes of closed runs; each is made in a copy.

    Parameters
    ----------
    runs : list of Path
        Closed runs that are sound.
    workspace : Path
        An empty folder.
    """

    def __init__(self, runs: list[Path], workspace: Path, seed: int) -> None:
        self._runs = runs
        self._workspace = workspace
        self._source = random.Random(seed)
        self._untouched: dict[tuple[Path, str], str] = {}

    def draw(self, number: int) -> ReadOutcome:
        """Make a change, drawn over every file of every run, and return its outcome."""
        source = self._source
        original = source.choice(self._runs)
        kind, command = source.choice(list(CHANGES)), list(COMMANDS)[number % len(COMMANDS)]
        before = self._expect(original, command)
        run = self._copy(original)
        # A root noted of the newest link vouches for everything.
        root = check_run(run).links[-1].sha256
        contents = _read_contents(run)
        while (changed := _find_changed(contents, _read_contents(run))) == ():
            self._change(self._copy(original), kind)
        told = _check(run)
        if "chain redone" in kind:
            redo_chain(run)
            exit_code, out, _ = _call("runs", "check", run, "--root", root, "--json")
            named = exit_code == 4 and root in out
            return ReadOutcome(original.parent.name, kind, changed, named, "", used_silently=False, told=told)
        exit_code, said, used = self._try(run, command)
        heard = said if exit_code == 4 else _select_notes(said)
        is_told = any(name in heard for name in _spell(changed))
        return ReadOutcome(
            original.parent.name, kind, changed, _names_one(told, changed), command,
            used_silently=not is_told and used != before, told=f"{told}\n{exit_code} {said}",
        )  # fmt: skip

    def _change(self, run: Path, kind: str) -> None:
        """Change a file that is not empty; whoever writes the chain anew need not change it first."""
        is_redone = "redone" in kind
        files = sorted(path for path in run.rglob("*") if path.is_file() and path.stat().st_size)
        files = [path for path in files if not (is_redone and path.name == "chain.jsonl")]
        CHANGES[kind](self._source.choice(files), self._source)
        if is_redone:
            # Where two files of other kinds were exchanged, nothing can be made to fit.
            with contextlib.suppress(ValueError, KeyError):
                redo_hashes(run)

    def _copy(self, original: Path) -> Path:
        run = self._workspace / "run"
        shutil.rmtree(run, ignore_errors=True)
        return Path(shutil.copytree(original, run))

    def _expect(self, original: Path, command: str) -> str:
        """Return what a command makes of the run as it is."""
        if (original, command) not in self._untouched:
            self._untouched[original, command] = self._try(self._copy(original), command)[2]
        return self._untouched[original, command]

    def _try(self, run: Path, command: str) -> tuple[int, str, str]:
        """Return exit code and messages of a command, and what it made."""
        out = self._workspace / "out"
        shutil.rmtree(out, ignore_errors=True)
        words = {"RUN": run, "OUT": out}
        exit_code, document, messages = _call(*(words.get(word, word) for word in COMMANDS[command]))
        made = f"{exit_code}"
        if command == "export" and out.is_dir():
            made += json.dumps({path.name: path.read_text() for path in sorted(out.iterdir())})
        elif command == "replay":
            made += document
        elif (run / "report.html").is_file():
            made += _WRITTEN.sub("", (run / "report.html").read_text(errors="replace"))
        return exit_code, document + messages, made


def _names_one(told: str, changed: tuple[str, ...]) -> bool:
    """Return whether one of the changed files is named, or the whole folder that it was added in."""
    return any(name in told or f'"where": "{name.rpartition("/")[0]}"' in told for name in changed)


def _select_notes(said: str) -> str:
    """Return the notes of a command that went on: what of the run it does not use."""
    return "\n".join(line for line in said.splitlines() if line.startswith("note: "))


def _spell(names: tuple[str, ...]) -> Iterator[str]:
    """Yield the changed files as messages name them: by its folder if a result was added, can.log for its checksums."""
    for name in names:
        folder, _, file = name.rpartition("/")
        yield from (name, file)
        if folder.startswith("analysis/"):
            yield folder
    if "can.sums.jsonl" in names:
        yield "can.log"


def _check(run: Path) -> str:
    exit_code, out, err = _call("runs", "check", run, "--json")
    return f"{exit_code} {out} {err}"


def _read_contents(run: Path) -> dict[str, bytes]:
    return {
        path.relative_to(run).as_posix(): path.read_bytes()
        for path in sorted(run.rglob("*"))
        if path.is_file() and not path.is_symlink()
    }


def _find_changed(before: Mapping[str, bytes], after: Mapping[str, bytes]) -> tuple[str, ...]:
    return tuple(sorted(name for name in before.keys() | after.keys() if before.get(name) != after.get(name)))
