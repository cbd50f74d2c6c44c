"""The table of a campaign as it grows: Parquet parts in a folder or at a URL, and the file that says whose they are.

That file also has the plan: how many tasks there are to be, and the rule that may end it earlier. More tasks may be
added to a plan; a rule is fixed before the first of them.

A part holds the rows of consecutive tasks and is written once, whole; its footer names the campaign. So what is there
after a kill, a full disk or a lost connection is the beginning of the table, and the next start goes on behind it.
"""

import hashlib
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from typing import Any, Self

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from labrig.analysis.installation import describe_installation, describe_kernels
from labrig.analysis.measured_campaign import BY_RULE, PART
from labrig.campaign.places import Place, open_place
from labrig.errors import DiskError, InputError, OutputExistsError, RecordError
from labrig.input_file import parse_json
from labrig.record.json_lines import encode_document
from labrig.record.layout import CAMPAIGN
from labrig.record.processor import describe_change

_OWNER, _FIRST = b"labrig.campaign", b"labrig.first_task"
_ELSEWHERE = "name another folder with --out"
_GO_ON = "{done} tasks are done, and the same command goes on behind them"

# What every row has, in this order; varied keys and values follow in the order in which they first appear.
_FIXED = {
    "task": pa.int64(),
    "arm": pa.string(),
    "repetition": pa.int64(),
    "seed": pa.int64(),
    "exit_status": pa.string(),
    "reason": pa.string(),
    "error": pa.string(),
}
_NULLABLE = {pa.int64(): pd.Int64Dtype(), pa.bool_(): pd.BooleanDtype(), pa.string(): pd.StringDtype()}


@dataclass(frozen=True)
class CampaignPlan:
    """How much of a campaign there is to be; unlike what decides its rows, it may grow.

    Attributes
    ----------
    arms : int
    tasks : int
        All of them, if no rule ends it earlier.
    measure : str
        The quantity that its page compares.
    rule : Mapping or None
        The rule that may end it earlier, as JSON, with all that it looks at; None: there is none.
    """

    arms: int
    tasks: int
    measure: str
    rule: Mapping[str, Any] | None


class CampaignStore:
    """The rows of a campaign at a place, of which this process is the only writer.

    Attributes
    ----------
    place : str
        A folder, or a URL that fsspec knows.
    done : int
        How many tasks have their rows: those from 0 on, without a gap.
    torn : str or None
        The last part, if its writing was cut short; its tasks are not among `done`, and their rows replace it.
    change : str
        How the kernels of this process differ from those that the campaign began with; empty if they do not.
    """

    def __init__(self, place: Place, owner: str) -> None:
        self._place = place
        self._owner = owner
        self._content: dict[str, Any] = {}
        self._parts: list[str] = []
        self._columns = dict(_FIXED)
        self.place = str(place)
        self.done = 0
        self.torn: str | None = None
        self.change = ""

    @classmethod
    def open(cls, place: str, document: Mapping[str, Any], plan: CampaignPlan) -> Self:
        """Begin a campaign, or go on with it.

        Parameters
        ----------
        place : str
            A folder, made if it is not there, or a URL. Once in use, it holds nothing but this campaign.
        document : Mapping
            All that decides the rows, as JSON holds it.
        plan : CampaignPlan
            How many rows there are to be, and when it ends.

        Raises
        ------
        OutputExistsError
            When something else is there.
        InputError
            When another campaign is there, or this one begun by another installation or with another rule, or more
            tasks of it are done than are planned; names the difference.
        RecordError
            When a part is damaged, missing or of another campaign.
        LockedError
            When another process writes there.
        DiskError
            When the place cannot be read or written.
        """
        text = json.dumps(document, sort_keys=True, allow_nan=False)
        with ExitStack() as held:
            opened = open_place(place)
            held.callback(opened.close)
            store = cls(opened, hashlib.sha256(text.encode()).hexdigest())
            store._begin(json.loads(text), plan)
            store._find_done()
            store._keep_plan(plan)
            held.pop_all()
        return store

    def __enter__(self) -> Self:
        """Return the open store."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """Let other processes write there."""
        self._place.close()

    def append(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Write the rows of the next tasks as one part.

        Parameters
        ----------
        rows : sequence of mapping
            At least one. `task` counts on from `done`; `arm`, `repetition`, `seed`, `exit_status`, `reason` and `error`
            are always there; then varied keys and values by name: numbers, truth values, texts, None where there is
            none. A column has one kind of value in all rows.

        Raises
        ------
        InputError
            When a column has values of two kinds.
        LockedError
            When another process has written the part.
        DiskError
            When it cannot be written; what is done stays done.
        """
        tasks = [row["task"] for row in rows]
        if tasks != list(range(self.done, self.done + len(rows))) or not rows:
            raise ValueError(f"rows of tasks {tasks[:3]}..., expected those from {self.done} on")
        part = self._make_part(rows)
        columns = _join_columns(self._columns, part.schema, self.place)
        name = f"part-{len(self._parts):06d}.parquet"
        buffer = io.BytesIO()
        pq.write_table(part, buffer, write_page_checksum=True)
        with _going_on(self.done):
            self._place.write(name, buffer.getvalue(), replace=name == self.torn)
        self._parts.append(name)
        self._columns = columns
        self.done += len(rows)
        self.torn = None

    @property
    def quantities(self) -> tuple[str, ...]:
        """The columns of the rows that are done, but for those that every row has, and for words."""
        return tuple(
            name
            for name, kind in self._columns.items()
            if name not in _FIXED and name != "point" and not pa.types.is_string(kind)
        )

    @property
    def ended_by_rule(self) -> bool:
        """Whether a rule ended the campaign before all of its tasks were done."""
        return self._content.get("ended") == BY_RULE

    def note_end(self) -> None:
        """Keep that a rule ended the campaign before all of its tasks were done. Raises `DiskError`."""
        if not self.ended_by_rule:
            self._write_document({**self._content, "ended": BY_RULE})

    def iter_parts(self) -> Iterator[pd.DataFrame]:
        """Yield the rows in order, a part at a time, all with the same columns and types. Raises `RecordError`."""
        schema = pa.schema(list(self._columns.items()))
        for name in self._parts:
            part = self._read_part(name)
            absent = {
                column: pa.nulls(len(part), kind)
                for column, kind in self._columns.items()
                if column not in part.column_names
            }
            for column, nulls in absent.items():
                part = part.append_column(column, nulls)
            yield _as_frame(part.select(schema.names).cast(schema))

    def read(self) -> pd.DataFrame:
        """Return all rows, in order; the same table whatever its parts. Raises `RecordError`."""
        empty = _as_frame(pa.schema(list(self._columns.items())).empty_table())
        parts = list(self.iter_parts())
        return pd.concat(parts, ignore_index=True) if parts else empty

    def _begin(self, document: Mapping[str, Any], plan: CampaignPlan) -> None:
        """Write the file of the campaign, or compare it with the one that is there."""
        names = self._place.list_names()
        if CAMPAIGN not in names:
            if names:
                raise OutputExistsError(f"{self.place} holds {names[0]} and no campaign", _ELSEWHERE)
            self._place.make()
            content = {
                "sha256": self._owner,
                "installation": describe_installation(),
                "processor": describe_kernels(),
                "plan": asdict(plan),
                "document": document,
            }
            self._write_document(content)
            return
        kept = self._content = dict(self._read_document())
        if kept.get("sha256") != self._owner:
            difference = _find_difference(kept.get("document"), document)
            raise InputError(f"{self.place} holds another campaign: {difference}", _ELSEWHERE)
        if kept.get("installation") != describe_installation():
            difference = _find_difference(kept.get("installation"), describe_installation())
            raise InputError(
                f"{self.place} was begun by another installation, whose rows may differ: {difference}",
                f"install that one again, or {_ELSEWHERE}",
            )
        self.change = describe_change(kept.get("processor"), describe_kernels())

    def _keep_plan(self, plan: CampaignPlan) -> None:
        """Compare the plan with the one that is kept, and keep it if it has changed."""
        kept, here = self._content.get("plan"), asdict(plan)
        if kept == here:
            return
        if self.done > plan.tasks:
            raise InputError(
                f"{self.place} holds {self.done} tasks, and the file asks for {plan.tasks}",
                f"ask for as many as there are, or more; or {_ELSEWHERE}",
            )
        rule = {"rule": here["rule"]}
        if self.done and isinstance(kept, Mapping) and kept.get("rule") != rule["rule"]:
            difference = _find_difference({"rule": kept.get("rule")}, rule)
            raise InputError(
                f"{self.place} was begun with another rule to stop: {difference}",
                f"a rule is fixed before the first task: put it back as it was, or {_ELSEWHERE}",
            )
        self._write_document({**self._content, "plan": here})

    def _write_document(self, content: Mapping[str, Any]) -> None:
        self._place.write(CAMPAIGN, encode_document(content), replace=bool(self._content))
        self._content = dict(content)

    def _read_document(self) -> Mapping[str, Any]:
        try:
            kept = parse_json(self._place.read(CAMPAIGN))
        except ValueError as error:
            raise RecordError(f"{self.place}/{CAMPAIGN} is damaged: {error}", _ELSEWHERE) from error
        return kept if isinstance(kept, Mapping) else {}

    def _find_done(self) -> None:
        """Count the tasks that parts hold; of the last part, if its writing was cut short, none."""
        names = [name for name in self._place.list_names() if PART.fullmatch(name)]
        for number, name in enumerate(names):
            if name != f"part-{number:06d}.parquet":
                raise RecordError(
                    f"{self.place}/part-{number:06d}.parquet is missing", f"restore it, or {_ELSEWHERE}"
                )
            try:
                schema, rows = self._read_footer(name)
            except pa.ArrowException as error:
                if name == names[-1]:
                    self.torn = name
                    return
                raise self._make_damage(name, str(error)) from error
            self._columns = _join_columns(self._columns, schema, self.place)
            self._parts.append(name)
            self.done += rows

    def _read_footer(self, name: str) -> tuple[pa.Schema, int]:
        footer = pq.read_metadata(io.BytesIO(self._place.read(name)))
        notes = footer.metadata or {}
        if notes.get(_OWNER) != self._owner.encode() or notes.get(_FIRST) != str(self.done).encode():
            raise RecordError(
                f"{self.place}/{name} is not the part of this campaign that begins at task {self.done}",
                f"restore the right one, or {_ELSEWHERE}",
            )
        return footer.schema.to_arrow_schema(), footer.num_rows

    def _read_part(self, name: str) -> pa.Table:
        try:
            return pq.read_table(io.BytesIO(self._place.read(name)), page_checksum_verification=True)
        except (pa.ArrowException, OSError) as error:
            raise self._make_damage(name, str(error)) from error

    def _make_damage(self, name: str, cause: str) -> RecordError:
        return RecordError(
            f"{self.place}/{name} is damaged: {cause}", f"restore it from a copy, or {_ELSEWHERE}"
        )

    def _make_part(self, rows: Sequence[Mapping[str, Any]]) -> pa.Table:
        names = dict.fromkeys([*_FIXED, *(name for row in rows for name in row)])
        arrays = {name: _make_array(name, [row.get(name) for row in rows]) for name in names}
        return pa.table(arrays).replace_schema_metadata({_OWNER: self._owner, _FIRST: str(self.done)})


def _make_array(name: str, values: Sequence[Any]) -> pa.Array:
    """Return the values of a column: whole numbers stay such, unless one of them is not whole."""
    if name in _FIXED:
        return pa.array(values, _FIXED[name])
    kinds = {type(value) for value in values if value is not None}
    if kinds == {int, float}:
        return pa.array([None if value is None else float(value) for value in values], pa.float64())
    if len(kinds) > 1 or not kinds <= {int, float, bool, str}:
        raise InputError(f"{name} has values of two kinds, or of one that is no number, text or truth value")
    return pa.array(values)


def _join_columns(
    columns: Mapping[str, pa.DataType], schema: pa.Schema, place: str
) -> dict[str, pa.DataType]:
    """Return the columns of a table to which a part is added; a type gives way to one that holds its values too."""
    joined = dict(columns)
    for field in schema:
        known = joined.get(field.name, field.type)
        if {known, field.type} == {pa.int64(), pa.float64()}:
            joined[field.name] = pa.float64()
        elif known == field.type or pa.types.is_null(field.type):
            joined[field.name] = known
        elif pa.types.is_null(known):
            joined[field.name] = field.type
        else:
            raise InputError(f"{field.name} is {field.type} here and {known} in other rows of {place}")
    return joined


def _as_frame(table: pa.Table) -> pd.DataFrame:
    frame: pd.DataFrame = table.to_pandas(types_mapper=_NULLABLE.get)
    return frame


def _find_difference(kept: object, given: object, where: str = "") -> str:
    """Return the first place where two values of JSON differ, with both values."""
    if isinstance(kept, Mapping) and isinstance(given, Mapping):
        for key in dict.fromkeys([*given, *kept]):
            if kept.get(key) != given.get(key) or (key in kept) != (key in given):
                return _find_difference(kept.get(key), given.get(key), f"{where}.{key}".lstrip("."))
    return f"{where or 'its file'} is {_shorten(kept)} there and {_shorten(given)} here"


def _shorten(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


@contextmanager
def _going_on(done: int) -> Iterator[None]:
    """Say of an error that the tasks before it are kept."""
    try:
        yield
    except DiskError as error:
        hint = f"{error.hint}; {_GO_ON.format(done=done)}"
        raise error.reword(error.message, hint) from error
