"""The rows of many scenes in little memory: a number takes 8 bytes, however many columns there are."""

import sys
from array import array
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeAlias, overload

Row = Mapping[str, Any]
#: A column: numbers of one type in an array, anything else (texts, counts by reason, None) in a list.
Column: TypeAlias = "array[int] | array[float] | list[Any]"


class SceneTable(Sequence[Row]):
    """Rows by column. A row read from it is a view; a column that a row does not have is None there."""

    def __init__(self) -> None:
        self._columns: dict[str, Column] = {}
        self._length = 0

    @property
    def columns(self) -> tuple[str, ...]:
        """Names, in the order in which they came up."""
        return tuple(self._columns)

    def append(self, row: Row) -> None:
        """Add a row."""
        for name, value in row.items():
            if name not in self._columns:
                self._columns[name] = [None] * self._length if self._length else _column_for(value)
        for name, column in self._columns.items():
            cell: Any = _compact(row.get(name))
            if isinstance(column, array) and type(cell) is not (float if column.typecode == "d" else int):
                self._columns[name] = [*column, cell]
            else:
                column.append(cell)
        self._length += 1

    def value(self, number: int, name: str) -> Any:  # noqa: ANN401  # whatever the column holds
        """One cell. Errors: KeyError for an unknown column."""
        return self._columns[name][number]

    @overload
    def __getitem__(self, number: int) -> Row: ...
    @overload
    def __getitem__(self, number: slice) -> Sequence[Row]: ...
    def __getitem__(self, number: int | slice) -> Row | Sequence[Row]:
        if isinstance(number, slice):
            return [_View(self, k) for k in range(*number.indices(self._length))]
        if not -self._length <= number < self._length:
            raise IndexError(number)
        return _View(self, number % self._length)

    def __len__(self) -> int:
        return self._length


class _View(Mapping[str, Any]):
    """One row of a table."""

    __slots__ = ("_number", "_table")

    def __init__(self, table: SceneTable, number: int) -> None:
        self._table = table
        self._number = number

    def __getitem__(self, name: str) -> Any:  # noqa: ANN401  # whatever the column holds
        return self._table.value(self._number, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._table.columns)

    def __len__(self) -> int:
        return len(self._table.columns)


def _column_for(value: object) -> Column:
    if type(value) is float:
        return array("d")
    return array("q") if type(value) is int else []


def _compact(value: object) -> object:
    """Texts that return in many scenes are kept once."""
    if isinstance(value, str):
        return sys.intern(value)
    if isinstance(value, dict):
        return {sys.intern(str(key)): count for key, count in value.items()}
    return value
