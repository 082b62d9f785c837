"""What a vehicle file says."""

import os
from typing import Optional, Sequence, Union

import numpy as np

from . import _native
from ._parameters import Parameters, ParametersLike, as_parameters


class Vehicle:
    """A vehicle as its YAML file describes it (docs/vehicle_file.md). Never changes; choose() makes another one."""

    def __init__(self, native: _native.Vehicle, file_vehicle: Optional[_native.Vehicle] = None,
                 parameters: Optional[Parameters] = None) -> None:
        self._native = native
        # Measured force and torque come from the file as it is, whatever is chosen.
        self._file = file_vehicle or native
        self._parameters = parameters

    @property
    def name(self) -> str:
        return self._native.name

    @property
    def mass_kg(self) -> float:
        return self._native.mass_kg

    @property
    def gravity_m_s2(self) -> float:
        return self._native.gravity_m_s2

    @property
    def inertia_kg_m2(self) -> np.ndarray:
        """Nominal moments about Bcm (3,): xx, yy, zz."""
        return self._native.inertia_kg_m2

    @property
    def num_rotors(self) -> int:
        return self._native.num_rotors

    @property
    def rotor_p_BP(self) -> np.ndarray:
        """Hubs from Bo in B [m] (rotors, 3)."""
        return self._native.rotor_p_BP

    @property
    def rotor_spin(self) -> np.ndarray:
        """+1 where a rotor turns clockwise seen from above, -1 counter-clockwise (rotors,)."""
        return self._native.rotor_spin

    @property
    def effects(self) -> Sequence[str]:
        """Names of the model's effects."""
        return tuple(self._native.effects)

    def choose(self, *, effects: Sequence[str] = (), without: Sequence[str] = (), free: Sequence[str] = (),
               freeze: Sequence[str] = (), parameters: Optional[ParametersLike] = None) -> 'Vehicle':
        """The vehicle with another model, as the tools' options of the same names choose it.

        effects replaces the file's list, without takes off it; free and freeze name parameters ('thrust.k_f') or
        effects to be estimated or held; parameters (an odmc.Parameters, or a file) brings effects, start values and
        priors of an earlier estimate. Raises ValueError naming what the model has not.
        """
        if effects and without:
            raise ValueError('effects and without exclude each other')
        start = None if parameters is None else as_parameters(parameters)
        chosen = self._file.choose(list(effects), list(without), list(free), list(freeze), None if start is None else start.native)
        return Vehicle(chosen, self._file, start)

    @property
    def native(self) -> _native.Vehicle:
        """For the package's own use."""
        return self._native

    @property
    def native_file(self) -> _native.Vehicle:
        """For the package's own use: the vehicle file as it is."""
        return self._file

    @property
    def start(self) -> Optional[Parameters]:
        """The parameters it was chosen with."""
        return self._parameters

    def __repr__(self) -> str:
        return f'<odmc.Vehicle {self.name}: {self.mass_kg:g} kg, {self.num_rotors} rotors, {len(self.effects)} effects>'


VehicleLike = Union[Vehicle, str, 'os.PathLike[str]']


def load_vehicle(file: Union[str, 'os.PathLike[str]']) -> Vehicle:
    """Reads a vehicle file (YAML). Raises ValueError naming file and key."""
    return Vehicle(_native.load_vehicle(os.fspath(file)))


def as_vehicle(vehicle: VehicleLike) -> Vehicle:
    """A vehicle, or the one of a file."""
    return vehicle if isinstance(vehicle, Vehicle) else load_vehicle(vehicle)
