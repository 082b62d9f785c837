"""Columns by name, as numpy arrays."""

from typing import Any, Dict, Iterator, Mapping

import numpy as np


class Table(Mapping[str, np.ndarray]):
    """Columns of equal length by name, each a numpy array (n,)."""

    def __init__(self, columns: Dict[str, np.ndarray]) -> None:
        self._columns = dict(columns)

    def __getitem__(self, name: str) -> np.ndarray:
        return self._columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    @property
    def rows(self) -> int:
        """Length of the columns."""
        return len(next(iter(self._columns.values()))) if self._columns else 0

    def vectors(self, before: str, after: str) -> np.ndarray:
        """Columns BEFORE + x, y, z + AFTER as one array (n, 3), as vectors('measured_force_', '_N')."""
        return np.column_stack([self._columns[f'{before}{axis}{after}'] for axis in 'xyz'])

    def to_pandas(self) -> Any:
        """The table as a pandas.DataFrame; needs pandas."""
        import pandas
        return pandas.DataFrame(self._columns)

    def __repr__(self) -> str:
        return f'<odmc.Table of {self.rows} rows: {", ".join(self._columns)}>'
