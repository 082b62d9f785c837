"""Effects, wrenches and their derivatives."""

import dataclasses
import math
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple, Union

import numpy as np

from . import _native
from ._parameters import Parameters
from ._vehicle import Vehicle, VehicleLike, as_vehicle

#: Columns of Wrench.d_state: v_AB_B, w_WB_B, theta of R_WB Exp(theta) with v_AB_B held, p_WB.
STATE_COLUMNS = {'v_AB_B': slice(0, 3), 'w_WB_B': slice(3, 6), 'theta_WB': slice(6, 9), 'p_WB': slice(9, 12)}


@dataclasses.dataclass(frozen=True)
class ParameterSpec:
    """Name, unit and prior of one parameter."""

    name: str  #: 'drag.d_x'
    unit: str
    description: str
    prior_value: float
    prior_sigma: float
    sign: str  #: what makes physical sense: 'positive', 'negative', 'any'
    estimated: bool  #: False: held at its prior value unless it is freed


@dataclasses.dataclass(frozen=True)
class Effect:
    """A physical effect of the catalogue."""

    name: str
    title: str
    formula: str
    source: str
    validity: str  #: where it stops being true
    adds_wrench: bool  #: adds forces or couples
    shapes_body: bool  #: changes mass, centre of mass, inertia, gravity, wind or the mounts
    parameters: Tuple[ParameterSpec, ...]


def list_effects(vehicle: Optional[VehicleLike] = None) -> List[Effect]:
    """Every effect that a model can have, with the priors of its parameters for this vehicle (docs/effects.md).

    Without a vehicle the priors are those of docs/model.md's quadrotor of 0.75 kg.
    """
    native = as_vehicle(vehicle).native if vehicle is not None else _native.nominal_vehicle()
    effects = []
    for entry in _native.effects(native):
        parameters = tuple(ParameterSpec(**p) for p in entry.pop('parameters'))
        effects.append(Effect(parameters=parameters, **entry))
    return effects


@dataclasses.dataclass
class State:
    """Flight states that effects look at, one (arrays as given) or n of them (a leading axis of length n).

    Each field may be given once for all states.
    """

    rotor_speed_rad_s: np.ndarray  #: (rotors,) or (n, rotors), mean over the interval
    v_AB_B: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))  #: of Bo relative to the air, in B [m/s]
    w_WB_B: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))  #: angular velocity in B [rad/s]
    R_WB: np.ndarray = dataclasses.field(default_factory=lambda: np.eye(3))  #: (3, 3), takes vectors from B to W
    p_WB: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))  #: Bo in W [m]
    time_s: Union[float, np.ndarray] = 0.0  #: since the flight's start
    rotor_acceleration_rad_s2: Optional[np.ndarray] = None  #: rate of the speeds; None: steady
    rotor_speed_squared: Optional[np.ndarray] = None  #: mean of the squares [rad^2/s^2]; None: square of the speed
    rotor_speed_squared_rate: Optional[np.ndarray] = None  #: [rad^2/s^3]; None: 2 speed x acceleration
    load_pull_W: np.ndarray = dataclasses.field(
        default_factory=lambda: np.array([0.0, 0.0, -9.81]))  #: of a hanging load, per kg of it, in W [m/s^2]

    def rows(self, rotors: int) -> Tuple[Optional[int], Dict[str, np.ndarray]]:
        """n (None: one state), and every field with n rows. Raises ValueError naming the field of another shape."""
        speed = np.asarray(self.rotor_speed_rad_s, dtype=float)
        acceleration = np.zeros_like(speed) if self.rotor_acceleration_rad_s2 is None else self.rotor_acceleration_rad_s2
        squared = speed ** 2 if self.rotor_speed_squared is None else self.rotor_speed_squared
        rate = 2.0 * speed * acceleration if self.rotor_speed_squared_rate is None else self.rotor_speed_squared_rate
        fields: Dict[str, Tuple[Any, Tuple[int, ...]]] = {
            'time_s': (self.time_s, ()), 'R_WB': (self.R_WB, (3, 3)), 'p_WB': (self.p_WB, (3,)),
            'v_AB_B': (self.v_AB_B, (3,)), 'w_WB_B': (self.w_WB_B, (3,)), 'rotor_speed_rad_s': (speed, (rotors,)),
            'rotor_speed_squared': (squared, (rotors,)), 'rotor_acceleration_rad_s2': (acceleration, (rotors,)),
            'rotor_speed_squared_rate': (rate, (rotors,)), 'load_pull_W': (self.load_pull_W, (3,))}
        arrays = {name: np.asarray(value, dtype=float) for name, (value, _) in fields.items()}
        count: Optional[int] = None
        for name, array in arrays.items():
            shape = fields[name][1]
            if array.shape == shape:
                continue
            if array.shape[1:] != shape or array.ndim != len(shape) + 1 or count not in (None, array.shape[0]):
                many = ', '.join(map(str, ('n' if count is None else count, *shape)))
                raise ValueError(f'{name} is of shape {array.shape}; expected {shape} or ({many})')
            count = array.shape[0]
        n = 1 if count is None else count
        return count, {name: np.broadcast_to(array, (n, *fields[name][1])).reshape((n, -1)) for name, array in arrays.items()}


@dataclasses.dataclass(frozen=True)
class Wrench:
    """Force and torque of a model on the body, and how they change. A leading axis n where the state has one."""

    f_B: np.ndarray  #: (3,) in B [N]
    tau_Bcm_B: np.ndarray  #: about the centre of mass, in B (3,) [N m]
    #: Derivatives of (f_B, tau_Bcm_B), None unless asked for. By the state (6, 12), columns as STATE_COLUMNS: v_AB_B,
    #: w_WB_B, theta of R_WB Exp(theta) with v_AB_B held, p_WB.
    d_state: Optional[np.ndarray] = None
    d_values: Optional[np.ndarray] = None  #: by the model's parameters (6, k)


@dataclasses.dataclass(frozen=True)
class BodyProperties:
    """What a model says of the body, gravity, the air and the mounts."""

    mass_kg: float
    p_BBcm: np.ndarray  #: centre of mass from Bo, in B [m]
    I_BBcm_B: np.ndarray  #: inertia about it (3, 3), in B [kg m^2]
    g_W: np.ndarray  #: gravity, about (0, 0, -9.81) [m/s^2]
    wind_W: np.ndarray  #: [m/s]
    p_BS: np.ndarray  #: odometry's sensor from Bo, in B [m]
    R_BS: np.ndarray  #: (3, 3)
    p_BI: np.ndarray  #: IMU from Bo, in B [m]
    R_BI: np.ndarray  #: (3, 3)
    #: Derivatives by the model's parameters (28, k). Rows: mass 0, p_BBcm 1, inertia xx yy zz xy xz yz 4, g_W 10,
    #: wind_W 13, p_BS 16, theta_BS 19, p_BI 22, theta_BI 25; theta as in R Exp(theta).
    d_values: np.ndarray = dataclasses.field(repr=False)


Values = Union[Parameters, Mapping[str, float], Sequence[float], np.ndarray, None]


class Model:
    """The rigid body with its effects. Never changes.

    vehicle: an odmc.Vehicle (choose() picks other effects) or a vehicle file.
    """

    def __init__(self, vehicle: VehicleLike) -> None:
        self._vehicle = as_vehicle(vehicle)
        self._native = _native.DynamicModel(self._vehicle.native)
        self._parameters = tuple(ParameterSpec(**p) for p in self._native.parameters)
        self._index = {p.name: i for i, p in enumerate(self._parameters)}

    @property
    def vehicle(self) -> Vehicle:
        return self._vehicle

    @property
    def effects(self) -> Sequence[str]:
        """Names of the effects."""
        return tuple(self._native.effect_names)

    @property
    def parameters(self) -> Sequence[ParameterSpec]:
        """The k parameters, in the order of every array of values."""
        return self._parameters

    def index(self, name: str) -> int:
        """Place of a parameter among the values. Raises ValueError naming those there are."""
        if name not in self._index:
            raise ValueError(f"the model has no parameter '{name}'; it has {', '.join(self._index)}")
        return self._index[name]

    def values(self, values: Values = None) -> np.ndarray:
        """Values of all parameters (k,), SI.

        None: what the vehicle starts with. An odmc.Parameters or a mapping by name replaces those that it has (an
        odmc.Parameters may hold more); an array must have all k.
        """
        if values is None:
            return np.array(self._native.initial_values)
        if isinstance(values, Parameters):
            return np.array(self._native.values_of(values.native))
        if isinstance(values, Mapping):
            found = np.array(self._native.initial_values)
            for name, value in values.items():
                found[self.index(name)] = value
            return found
        array = np.array(values, dtype=float)
        if array.shape != (len(self._parameters),):
            raise ValueError(f'values are of shape {array.shape}; expected ({len(self._parameters)},)')
        return array

    def properties(self, values: Values = None, *, time_s: float = math.inf) -> BodyProperties:
        """The body at these values, time_s after the flight's start (by default at its end)."""
        return BodyProperties(**self._native.properties(self.values(values), time_s))

    def wrench(self, state: State, values: Values = None, *, derivatives: bool = False) -> Wrench:
        """Force and torque about the centre of mass, in B, of all effects together; gravity is not among them.

        The centre of mass is the one that the values say. d_values are total derivatives: they count that a parameter
        moves the centre of mass, too. Raises ValueError naming a field of `state` of wrong shape.
        """
        count, states, chosen, centres, motion = self._prepare(state, values)
        found = self._native.wrench(states, chosen, centres, derivatives)
        if derivatives:
            found['d_values'] = found['d_values'] + found['d_p_BBcm'] @ motion
        found.pop('d_p_BBcm', None)
        found['f_B'], found['tau_Bcm_B'] = found['f_B'][:, 0], found['tau_Bcm_B'][:, 0]
        return Wrench(**(found if count is not None else {name: array[0] for name, array in found.items()}))

    def effect_wrenches(self, state: State, values: Values = None) -> Dict[str, Wrench]:
        """The same of each effect that adds a wrench, by name."""
        count, states, chosen, centres, _ = self._prepare(state, values)
        found = self._native.effect_wrenches(states, chosen, centres)
        return {name: Wrench(*((array[:, 0] if count is not None else array[0, 0]) for array in pair))
                for name, pair in found.items()}

    def _prepare(self, state: State, values: Values) -> Tuple[Optional[int], Any, np.ndarray, np.ndarray, np.ndarray]:
        """States, values, centre of mass of each state (n, 3), its derivative by the values (n, 3, k)."""
        chosen = self.values(values)
        count, rows = state.rows(self._vehicle.num_rotors)
        times, places = np.unique(rows['time_s'][:, 0], return_inverse=True)
        if len(times) > 1 and not self._native.varies:
            times, places = times[:1], np.zeros(len(places), dtype=int)
        bodies = [self._native.properties(chosen, time_s) for time_s in times]
        centres = np.array([body['p_BBcm'] for body in bodies])[places]
        motion = np.array([body['d_values'][1:4] for body in bodies])[places]
        states = _native.States(rows['time_s'][:, 0], rows['R_WB'], rows['p_WB'], rows['v_AB_B'], rows['w_WB_B'],
                                rows['rotor_speed_rad_s'], rows['rotor_speed_squared'], rows['rotor_acceleration_rad_s2'],
                                rows['rotor_speed_squared_rate'], rows['load_pull_W'])
        return count, states, chosen, centres, motion

    def __repr__(self) -> str:
        return f'<odmc.Model of {self._vehicle.name}: {", ".join(self.effects)}; {len(self._parameters)} parameters>'
