"""Calibrated parameters."""

import dataclasses
import os
from typing import Any, Dict, Iterator, Mapping, Sequence, Union

import numpy as np

from . import _native


@dataclasses.dataclass(frozen=True)
class Parameter:
    """One estimated or held parameter, SI units."""

    name: str  #: 'thrust.k_f'
    value: float
    sigma: float  #: standard deviation; 0 where it was held
    unit: str
    estimated: bool  #: False: held at its value
    observable: bool  #: the flight says more about it than its prior did
    scatter: float  #: standard deviation between flights, where many were seen; else 0

    def __str__(self) -> str:
        return f'{self.name} = {self.value:.6g} +- {self.sigma:.2g} {self.unit}' if self.estimated else \
            f'{self.name} = {self.value:.6g} {self.unit} (held)'


class Parameters(Mapping[str, Parameter]):
    """A calibrated model: Parameter by full name, in the model's order."""

    def __init__(self, native: _native.ParameterSet) -> None:
        self._native = native
        self._by_name = {entry['name']: Parameter(**entry) for entry in native.estimates}

    def __getitem__(self, name: str) -> Parameter:
        return self._by_name[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_name)

    def __len__(self) -> int:
        return len(self._by_name)

    @property
    def effects(self) -> Sequence[str]:
        """Names of the model's effects."""
        return tuple(self._native.effects)

    @property
    def vector(self) -> np.ndarray:
        """Values of all parameters (n,), in the order of the names."""
        return np.array([p.value for p in self._by_name.values()])

    @property
    def sigma_vector(self) -> np.ndarray:
        """Standard deviations (n,); 0 where held."""
        return np.array([p.sigma for p in self._by_name.values()])

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (n, n) in the parameters' units, zero rows where held; (0, 0) where it is not known."""
        return self._native.covariance

    @property
    def provenance(self) -> Dict[str, str]:
        """Where the values come from: tool, version, flight, vehicle, trust."""
        return dict(self._native.provenance)

    @property
    def native(self) -> _native.ParameterSet:
        """For the package's own use."""
        return self._native

    def save(self, file: Union[str, 'os.PathLike[str]']) -> None:
        """Writes a parameters.yaml as calibrate does."""
        self._native.save(os.fspath(file))

    def to_pandas(self) -> Any:
        """A pandas.DataFrame with a row for each parameter; needs pandas."""
        import pandas
        return pandas.DataFrame([dataclasses.asdict(p) for p in self._by_name.values()]).set_index('name')

    def __repr__(self) -> str:
        return '\n'.join(str(p) for p in self._by_name.values())


ParametersLike = Union[Parameters, str, 'os.PathLike[str]']


def load_parameters(file: Union[str, 'os.PathLike[str]']) -> Parameters:
    """Reads a parameters.yaml. Raises ValueError naming file and key."""
    return Parameters(_native.load_parameters(os.fspath(file)))


def as_parameters(parameters: ParametersLike) -> Parameters:
    """Parameters, or those of a file."""
    return parameters if isinstance(parameters, Parameters) else load_parameters(parameters)
